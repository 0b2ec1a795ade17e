//! The facts of a scene, and answers: the decisions of the rules in it, with what the egos see.

use crate::city::{Action, ActionTable, KindId};
use crate::datalog::Value;
use crate::datalog::internal::size;
use crate::diag::{self, Diagnostic, Limit};
use crate::predicate::Unit;
use crate::sim::tick::ground::{Facts, json_value};
use crate::sim::tick::vocabulary::{Actions, BasePredicate, Vocabulary};
use serde_json::json;
use std::borrow::Cow;
use std::io::{self, Write};
use std::sync::Arc;

/// The entities and base facts of a scene.
#[derive(Clone, Debug)]
pub struct SceneFacts {
    /// The names of the entities.
    pub names: Vec<String>,
    /// Their kinds; empty if the scene does not say.
    pub kinds: Vec<KindId>,
    /// The positions of the egos.
    pub egos: Vec<usize>,
    /// The base facts.
    pub facts: Facts,
    /// The actions that entities took, by position, if the scene states them. Inference ignores them.
    pub actions: Vec<(usize, Action)>,
    /// The base facts that hold only with a probability: the predicate by its position in the vocabulary, the row, and
    /// the probability. They are among the facts, too.
    pub uncertain: Vec<(usize, [u32; 2], f64)>,
}

/// The decisions of the rules for the egos of a scene.
///
/// What an ego sees is computed on demand: together, the egos of a crowd see far more than the scene says.
#[derive(Clone, Debug)]
pub struct Answer<'s> {
    pub(super) vocabulary: Arc<Vocabulary>,
    pub(super) scene: Cow<'s, SceneFacts>,
    /// The derived actions of each ego.
    pub(super) derived: Vec<Actions>,
    /// Why the relational executor decided although the dense one can evaluate the rules: a sentence without a full
    /// stop.
    pub fallback: Option<String>,
}

/// The decision of the rules for one ego.
#[derive(Clone, Debug)]
pub struct EgoAnswer {
    /// The name of the ego.
    pub id: String,
    /// The names of all entities in its field of view: itself first, the others in list order.
    pub sees: Vec<String>,
    /// The true atoms over these entities, by base predicate, without `Sees`. The row of a quantity ends with its value.
    pub atoms: Vec<(String, Vec<Vec<String>>)>,
    /// The derived actions, without the default.
    pub derived: Actions,
    /// The action to take.
    pub action: Action,
}

impl Answer<'_> {
    /// Returns the names of the egos with their actions, in the order of the scene.
    pub fn actions(&self) -> impl Iterator<Item = (&str, Action)> {
        let decided = self.scene.egos.iter().zip(&self.derived);
        decided.map(|(&ego, &derived)| (self.scene.names[ego].as_str(), self.decide(ego, derived)))
    }

    fn decide(&self, ego: usize, derived: Actions) -> Action {
        self.vocabulary.decide(self.scene.kinds.get(ego).copied(), derived)
    }

    fn before_default(&self, ego: usize, derived: Actions) -> Actions {
        (self.vocabulary).before_default(self.scene.kinds.get(ego).copied(), derived)
    }

    /// Returns the actions of the configuration.
    pub fn table(&self) -> &ActionTable {
        self.vocabulary.actions()
    }

    /// Returns one answer per ego, in the order of the scene.
    pub fn egos(&self) -> impl Iterator<Item = EgoAnswer> {
        let names = &self.scene.names;
        self.scene.egos.iter().zip(&self.derived).map(move |(&ego, &derived)| {
            let view = View::of(&self.vocabulary, &self.scene, ego);
            let name = |entity: &usize| names[*entity].clone();
            let atoms = view.atoms().map(|(predicate, rows)| {
                let rows = rows.iter().map(|row| {
                    let value = row
                        .value()
                        .map(|value| value.as_str().map_or(value.to_string(), str::to_owned));
                    row.entities.iter().map(name).chain(value).collect()
                });
                (predicate.name.clone(), rows.collect())
            });
            EgoAnswer {
                id: name(&ego),
                atoms: atoms.collect(),
                sees: view.entities.iter().map(name).collect(),
                action: self.decide(ego, derived),
                derived: self.before_default(ego, derived),
            }
        })
    }

    /// Writes the answer as JSON: `{"egos": {ID: {"sees": [..], "true": {..}, "derived": [..], "action": ".."}}}`. A row
    /// with one name is a plain string. `more` are further keys with their values.
    ///
    /// # Errors
    /// The errors of `out`.
    pub fn write_json<'m>(
        &self,
        out: &mut dyn Write,
        more: impl IntoIterator<Item = (&'m str, &'m serde_json::Value)>,
    ) -> io::Result<()> {
        let quoted = |text: &str| json!(text).to_string();
        let names: Vec<String> = self.scene.names.iter().map(|name| quoted(name)).collect();
        out.write_all(b"{\"egos\":{")?;
        for (position, (&ego, &derived)) in self.scene.egos.iter().zip(&self.derived).enumerate() {
            let view = View::of(&self.vocabulary, &self.scene, ego);
            write!(out, "{}{}:{{\"sees\":", comma(position), names[ego])?;
            write_list(out, &view.entities, |out, &entity| {
                out.write_all(names[entity].as_bytes())
            })?;
            out.write_all(b",\"true\":{")?;
            for (position, (predicate, rows)) in view.atoms().enumerate() {
                write!(out, "{}{}:", comma(position), quoted(&predicate.name))?;
                write_list(out, &rows, |out, row| row.write(out, &names))?;
            }
            let actions = self.before_default(ego, derived);
            let table = self.table();
            let actions: Vec<&str> = actions.iter().map(|action| table.name(action)).collect();
            let action = table.name(self.decide(ego, derived));
            write!(out, "}},\"derived\":{},\"action\":{}}}", json!(actions), json!(action))?;
        }
        out.write_all(b"}")?;
        for (key, value) in more {
            write!(out, ",{}:{value}", quoted(key))?;
        }
        out.write_all(b"}")
    }

    /// Returns the answer as JSON; see [`Answer::write_json`].
    ///
    /// # Errors
    /// `limit-exceeded` if it takes more than about `limit` bytes.
    pub fn to_json(&self, limit: u64) -> Result<serde_json::Value, Diagnostic> {
        /// The memory of a row of two names: as text, as JSON, and once more in the language of a caller.
        const ROW_BYTES: u64 = 512;
        let mut rows = 0;
        for &ego in &self.scene.egos {
            let view = View::of(&self.vocabulary, &self.scene, ego);
            rows += view.entities.len() + view.atoms().map(|(_, rows)| rows.len()).sum::<usize>();
            if rows as u64 > limit / ROW_BYTES {
                let message = format!("the answer takes more than {}", size(limit));
                let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).exceeds(Limit::Memory(limit));
                return Err(fault.help("name fewer `egos` in the scene"));
            }
        }
        let mut text = Vec::new();
        self.write_json(&mut text, []).expect("writing to memory cannot fail");
        Ok(serde_json::from_slice(&text).expect("it has been written as JSON"))
    }
}

/// Returns what separates the element at a position from the one before it.
pub(super) fn comma(position: usize) -> &'static str {
    if position > 0 { "," } else { "" }
}

fn write_list<T>(
    out: &mut dyn Write,
    list: &[T],
    write: impl Fn(&mut dyn Write, &T) -> io::Result<()>,
) -> io::Result<()> {
    out.write_all(b"[")?;
    for (position, element) in list.iter().enumerate() {
        out.write_all(comma(position).as_bytes())?;
        write(out, element)?;
    }
    out.write_all(b"]")
}

/// What an ego sees.
struct View<'a> {
    vocabulary: &'a Vocabulary,
    facts: &'a Facts,
    /// The entities in view: the ego first, the others in list order.
    entities: Vec<usize>,
    /// The position in `entities` of each entity of the scene.
    places: Vec<Option<usize>>,
}

impl<'a> View<'a> {
    fn of(vocabulary: &'a Vocabulary, scene: &'a SceneFacts, ego: usize) -> Self {
        let others = scene.facts.rows[vocabulary.sees]
            .iter()
            .filter(|[x, _]| *x as usize == ego)
            .map(|[_, y]| *y as usize)
            .filter(|&y| y != ego);
        let entities: Vec<usize> = std::iter::once(ego).chain(others).collect();
        let mut places = vec![None; scene.names.len()];
        for (place, &entity) in entities.iter().enumerate() {
            places[entity] = Some(place);
        }
        View {
            vocabulary,
            facts: &scene.facts,
            entities,
            places,
        }
    }

    /// Returns the true atoms over the entities in view without `Sees`: each predicate that has some, by its position in
    /// the vocabulary, and its rows of entities in the order of the view, with the value of a quantity.
    fn atoms(&self) -> impl Iterator<Item = (&'a BasePredicate, Vec<ViewRow>)> {
        let predicates = self.vocabulary.predicates.iter().enumerate();
        let others = predicates.filter(|(index, _)| *index != self.vocabulary.sees);
        others.filter_map(|(index, predicate)| {
            // Columns that the predicate does not have contain 0, which need not be in view.
            let place = |(at, row): (usize, &[u32; 2])| -> Option<([usize; 2], Option<Value>)> {
                let mut places = [0; 2];
                for (place, entity) in places.iter_mut().zip(&row[..predicate.arity]) {
                    *place = self.places[*entity as usize]?;
                }
                Some((places, self.facts.values[index].get(at).copied()))
            };
            let mut rows: Vec<_> = self.facts.rows[index].iter().enumerate().filter_map(place).collect();
            rows.sort_unstable();
            let rows = rows.into_iter().map(|(places, value)| ViewRow {
                entities: places[..predicate.arity]
                    .iter()
                    .map(|place| self.entities[*place])
                    .collect(),
                value: value.zip(predicate.definition.unit()),
            });
            let rows: Vec<ViewRow> = rows.collect();
            (!rows.is_empty()).then_some((predicate, rows))
        })
    }
}

/// A row of a predicate in a view.
struct ViewRow {
    entities: Vec<usize>,
    value: Option<(Value, Unit)>,
}

impl ViewRow {
    /// Returns the value of a quantity as JSON.
    fn value(&self) -> Option<serde_json::Value> {
        self.value.map(|(value, unit)| json_value(value, unit))
    }

    /// Writes the row as JSON: a list, or its only element. `names` are those of the entities, as JSON.
    fn write(&self, out: &mut dyn Write, names: &[String]) -> io::Result<()> {
        let is_list = self.entities.len() + usize::from(self.value.is_some()) != 1;
        out.write_all(if is_list { b"[" } else { b"" })?;
        for (position, &entity) in self.entities.iter().enumerate() {
            out.write_all(comma(position).as_bytes())?;
            out.write_all(names[entity].as_bytes())?;
        }
        if let Some(value) = self.value() {
            write!(out, "{}{value}", comma(self.entities.len()))?;
        }
        out.write_all(if is_list { b"]" } else { b"" })
    }
}
