//! `logicity shortcuts`: counts the confusions of concepts that rules cannot tell apart.

use crate::builtin::BuiltinFiles;
use crate::cli::configuration::{Checked, Opened, open, open_run};
use crate::cli::failure::Failure;
use crate::cli::limits::MemoryOption;
use crate::cli::load::{inputs_of, load_workspace};
use crate::cli::report::report;
use crate::cli::terminal;
use crate::cli::values::{integer, one_of};
use crate::config::{ActionsConfig, SEES, rule_file};
use crate::datalog::codes;
use crate::datalog::diff::shortcuts::{
    ConceptMap, ConceptMaps, Image, ShortcutOptions, Shortcuts, Stopped, Witness, identity, remedy, shortcuts, witness,
};
use crate::datalog::{Atom, Clause, InputPolicy, Literal, Past, PredicateId, Rules, Term};
use crate::diag::{Diagnostic, Sources, counted, listed};
use crate::sim::{earlier_facts, examine, scene_json};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::io::Write;
use std::path::PathBuf;

#[derive(clap::Args)]
pub struct Arguments {
    /// Rule file, or the configuration of a city with its rules
    rules: PathBuf,
    /// Configuration of the city for which the rules are checked; its constraints hold in all scenes, and its order of
    /// actions decides [default: the constraints that the rules declare, and Stop, Slow, Fast, Normal]
    #[arg(long, value_name = "CONFIG")]
    config: Option<PathBuf>,
    /// The maps to search. permutations: each concept stands for exactly one. signed: or for the negation of one. all:
    /// concepts may also merge, or be reported always or never
    #[arg(long, value_parser = one_of(&ConceptMaps::ALL, ConceptMaps::name), default_value = "all")]
    maps: ConceptMaps,
    /// The concepts that perception may confuse, separated by commas; the others have labels [default: all that the
    /// decisions depend on]
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    concepts: Vec<String>,
    /// Search scenes of at most this many entities
    #[arg(long, value_name = "COUNT", value_parser = integer(1..=8_usize),
        default_value_t = ShortcutOptions::default().entities_max)]
    entities: usize,
    /// Stop after this many conflicts of the search
    #[arg(long, value_name = "COUNT", value_parser = integer(0..=u64::MAX),
        default_value_t = ShortcutOptions::default().conflicts_max)]
    effort: u64,
    /// List at most this many maps
    #[arg(long, value_name = "COUNT", value_parser = integer(1..=1_000_000_usize),
        default_value_t = ShortcutOptions::default().maps_max)]
    limit: usize,
    /// For each pair of concepts, print a scene in which exchanging them changes the decision
    #[arg(long)]
    pairs: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    _memory: MemoryOption,
}

/// The number of shortcuts printed without `--json`.
const SHOWN_MAX: usize = 20;

pub fn run(arguments: &Arguments, sources: &mut Sources) -> Result<(), Failure> {
    let (rules, actions) = load(arguments, sources)?;
    // What rules read of earlier ticks is given, but it is read.
    let operands: Vec<PredicateId> = rules.pasts.iter().flat_map(Past::operands).collect();
    let remembered = |id: &PredicateId| operands.iter().any(|operand| rules.depends_on(*operand, *id));
    let now = rules.of_one_tick();
    let order = order(&now, &actions);
    if order.is_empty() {
        let message = format!("`{}` derives no action", arguments.rules.display());
        let names: Vec<&str> = actions.table.names().collect();
        let fault = Diagnostic::new(codes::RULE_MISMATCH, message);
        return Err(fault.help(format!("derive one of {}", names.join(", "))).into());
    }
    let names = arguments.concepts.iter().map(|name| name.trim());
    let concepts: Vec<String> = names.filter(|name| !name.is_empty()).map(str::to_owned).collect();
    if concepts.is_empty() && !arguments.concepts.is_empty() {
        return Err(Failure::Usage("--concepts names no concept".to_owned()));
    }
    let options = ShortcutOptions {
        maps: arguments.maps,
        concepts,
        views: rules.predicate(SEES).into_iter().collect(),
        default_action: rules.predicate(actions.table.name(actions.default)),
        entities_max: arguments.entities,
        conflicts_max: arguments.effort,
        maps_max: arguments.limit,
    };
    let mut found = shortcuts(&now, &order, &options).map_err(|faults| match arguments.concepts.is_empty() {
        true => Failure::Input(faults),
        false => Failure::option(faults),
    })?;
    found.unread.retain(|id| !remembered(id));
    let answer = Answer {
        rules: &now,
        order: &order,
        options: &options,
        found: &found,
    };
    let mut out = terminal::results(arguments.json);
    if arguments.json {
        writeln!(out, "{}", answer.json(arguments.pairs)?)?;
        return Ok(());
    }
    answer.print(&mut out)?;
    if arguments.pairs {
        answer.print_pairs(&mut out)?;
    }
    Ok(())
}

/// Loads the rules with the constraints that hold in the city, and its actions.
fn load(arguments: &Arguments, sources: &mut Sources) -> Result<(Rules, ActionsConfig), Failure> {
    let given = || rule_file(&arguments.rules, &BuiltinFiles);
    let (path, city) = match &arguments.config {
        Some(config) => (given(), Some(open_run(config, sources)?)),
        None => match open(&arguments.rules, sources)? {
            Opened::Run(run) => (run.rules().to_owned(), Some(run)),
            Opened::Rules => (given(), None),
            Opened::Faulty(faults) => return Err(faults.into()),
            Opened::Map(_) => {
                let message = "name a rule file, or a configuration with rules";
                return Err(Failure::Usage(message.to_owned()));
            }
        },
    };
    let mut texts = load_workspace(sources, &path, InputPolicy::Fixed)?;
    texts.set_inputs(inputs_of(&texts, city.is_some()));
    let loaded = texts.check();
    let Some(rules) = loaded.rules else {
        return Err(loaded.diagnostics.into());
    };
    report(&loaded.diagnostics, sources);
    let rules = examine(&rules, city.as_ref().and_then(Checked::theory), sources).in_city;
    Ok((
        rules,
        city.as_ref().map_or_else(ActionsConfig::default, Checked::actions),
    ))
}

/// Returns the derived actions in order of precedence.
fn order(rules: &Rules, actions: &ActionsConfig) -> Vec<PredicateId> {
    let names = actions.priority.iter().chain([&actions.default]);
    let mut order: Vec<PredicateId> = Vec::new();
    for name in names.map(|action| actions.table.name(*action)) {
        let derived = rules.predicate(name).filter(|id| {
            let predicate = &rules.predicates[id.index()];
            predicate.derived && predicate.columns.len() == 1
        });
        order.extend(derived.filter(|id| !order.contains(id)));
    }
    order
}

/// Two concepts that are exchanged, by their positions.
type Exchange = [usize; 2];

/// What was found, with what the words for it need.
struct Answer<'a> {
    rules: &'a Rules,
    order: &'a [PredicateId],
    options: &'a ShortcutOptions,
    found: &'a Shortcuts,
}

impl Answer<'_> {
    fn name(&self, predicate: PredicateId) -> &str {
        &self.rules.predicates[predicate.index()].name
    }

    fn concept(&self, position: usize) -> &str {
        self.name(self.found.concepts[position])
    }

    /// Returns what a concept is taken for.
    fn image(&self, image: Image) -> String {
        match image {
            Image::Concept { position, negated } => match negated {
                false => self.concept(position).to_owned(),
                true => format!("not {}", self.concept(position)),
            },
            Image::Constant(true) => "always".to_owned(),
            Image::Constant(false) => "never".to_owned(),
        }
    }

    /// Returns the maps that confuse concepts.
    fn shortcuts(&self) -> impl Iterator<Item = &ConceptMap> {
        self.found.maps.iter().filter(|map| !map.is_same())
    }

    /// Returns a smallest set of concepts whose labels exclude all shortcuts; `None` if not all are known.
    fn labels(&self) -> Option<Vec<&str>> {
        if self.found.stopped.is_some() {
            return None;
        }
        let confused = |map: &ConceptMap| {
            let all = map.confused.iter().enumerate();
            all.filter(|(_, confused)| **confused).map(|(at, _)| at).collect()
        };
        let mut sets: Vec<BTreeSet<usize>> = self.shortcuts().map(confused).collect();
        // A set that contains another is hit whenever the other is.
        sets.sort_by_key(BTreeSet::len);
        let mut least: Vec<BTreeSet<usize>> = Vec::new();
        for set in sets {
            if !least.iter().any(|known| known.is_subset(&set)) {
                least.push(set);
            }
        }
        let chosen = (0..=self.found.concepts.len()).find_map(|size| hit(&least, size));
        let chosen = chosen.expect("the labels of all concepts exclude every confusion");
        Some(chosen.into_iter().map(|at| self.concept(at)).collect())
    }

    /// Returns a clause that would expose a confusion.
    fn clause(&self, map: &ConceptMap) -> Result<Option<String>, Failure> {
        let confused = map.confused.iter().enumerate().filter(|(_, confused)| **confused);
        for (concept, _) in confused {
            let concepts = &self.found.concepts;
            if let Some(clause) = remedy(self.rules, self.order, self.options, (map, concepts), concept)? {
                return Ok(Some(self.written(&clause)));
            }
        }
        Ok(None)
    }

    fn written(&self, clause: &Clause) -> String {
        let atom = |atom: &Atom| {
            let terms = atom.terms.iter().map(|term| match term {
                Term::Variable(variable) => clause.variables[variable.index()].as_str(),
                Term::Constant(_) | Term::Wildcard => "_",
            });
            format!(
                "{}({})",
                self.name(atom.predicate),
                terms.collect::<Vec<_>>().join(", ")
            )
        };
        let body = clause.body.iter().filter_map(|literal| {
            let text = atom(literal.atom()?);
            Some(match literal {
                Literal::Negative(_) => format!("Not({text})"),
                _ => text,
            })
        });
        format!("{} :- {}.", atom(&clause.head), body.collect::<Vec<_>>().join(", "))
    }

    /// Returns the pairs of concepts with images of their own, each with the scene that tells them apart.
    fn pairs(&self) -> impl Iterator<Item = Result<(Exchange, Result<Option<Witness>, Stopped>), Failure>> {
        let count = self.found.concepts.len();
        let arity = |at: usize| self.rules.predicates[self.found.concepts[at].index()].arity();
        let pairs = (0..count).flat_map(move |one| (one + 1..count).map(move |other| [one, other]));
        pairs
            .filter(move |[one, other]| arity(*one) == arity(*other))
            .map(move |[one, other]| {
                let mut images: Vec<Image> = (0..count).map(identity).collect();
                images.swap(one, other);
                let found = witness(self.rules, self.order, self.options, &images)?;
                Ok(([one, other], found))
            })
    }

    fn decision(&self, decision: Option<PredicateId>) -> &str {
        decision.map_or("none", |action| self.name(action))
    }

    fn print(&self, out: &mut impl Write) -> Result<(), Failure> {
        let names: Vec<&str> = self.found.concepts.iter().map(|id| self.name(*id)).collect();
        let (count, names) = (counted(names.len(), "concept"), names.join(", "));
        match self.options.concepts.is_empty() {
            true => writeln!(out, "the decisions depend on {count}: {names}")?,
            false => writeln!(out, "perception may confuse {count}: {names}")?,
        }
        if !self.found.given.is_empty() {
            let given: Vec<&str> = self.found.given.iter().map(|id| self.name(*id)).collect();
            writeln!(out, "taken as given: {}", given.join(", "))?;
        }
        if !self.found.unread.is_empty() {
            let unread: Vec<&str> = self.found.unread.iter().map(|id| self.name(*id)).collect();
            writeln!(out, "no decision depends on {}", unread.join(", "))?;
        }
        let entities = self.entities();
        let same = self.found.maps.iter().filter(|map| map.is_same()).count();
        let count = self.shortcuts().count();
        let (most, all) = (
            if self.found.stopped.is_none() { "" } else { "at least " },
            self.found.maps.len(),
        );
        let verb = if all == 1 { "changes" } else { "change" };
        if all == 0 {
            writeln!(out, "the search ended before it found a map")?;
        } else {
            writeln!(
                out,
                "{most}{} {verb} no decision in scenes of {entities}: {same} with the same meaning, {}",
                counted(all, "map"),
                counted(count, "shortcut"),
            )?;
        }
        match self.found.stopped {
            None => {}
            Some(Stopped::Conflicts) => {
                writeln!(out, "  stopped after --effort conflicts: raise it, or lower --entities")?
            }
            Some(Stopped::Maps) => writeln!(out, "  stopped at --limit maps: raise it")?,
            Some(Stopped::Size) => {
                writeln!(
                    out,
                    "  the formula is too large: lower --entities, or name fewer --concepts"
                )?;
            }
        }
        // Other maps combine these with images of the same meaning.
        let is_plain = |map: &&ConceptMap| {
            let mut images = map.images.iter().enumerate();
            images.all(|(at, image)| map.confused[at] || *image == identity(at))
        };
        let plain: Vec<&ConceptMap> = self.shortcuts().filter(is_plain).collect();
        for map in plain.iter().take(SHOWN_MAX) {
            let moved = map.images.iter().enumerate().filter(|(at, _)| map.confused[*at]);
            let moved: Vec<String> = moved
                .map(|(at, image)| format!("{} = {}", self.concept(at), self.image(*image)))
                .collect();
            writeln!(out, "  {}", moved.join(", "))?;
            if let Some(clause) = self.clause(map)? {
                writeln!(out, "    would change decisions with {clause}")?;
            }
        }
        let shown = plain.len().min(SHOWN_MAX);
        if count > shown {
            writeln!(out, "  and {} more; --json lists all", count - shown)?;
        }
        if let Some(labels) = self.labels().filter(|_| count > 0) {
            writeln!(out, "labels of {} would exclude all shortcuts", listed(&labels))?;
        }
        Ok(())
    }

    /// Returns the largest number of entities in a scene, in words.
    fn entities(&self) -> String {
        match self.options.entities_max {
            1 => "one entity".to_owned(),
            more => format!("at most {more} entities"),
        }
    }

    fn print_pairs(&self, out: &mut impl Write) -> Result<(), Failure> {
        let entities = self.entities();
        for pair in self.pairs() {
            let ([one, other], found) = pair?;
            let names = format!("{} and {}", self.concept(one), self.concept(other));
            match found {
                Err(_) => writeln!(out, "{names}: undecided; raise --effort, or lower --entities")?,
                Ok(None) => {
                    writeln!(out, "{names}: no scene of {entities} tells them apart")?;
                }
                Ok(Some(Witness { scene, decisions })) => {
                    let [right, wrong] = decisions.map(|decision| self.decision(decision));
                    writeln!(out, "{names}: {right}, and {wrong} if exchanged, in")?;
                    writeln!(out, "  {}", scene_json(&scene, &[self.rules]))?;
                    let earlier = earlier_facts(&scene, self.rules);
                    if !earlier.is_empty() {
                        writeln!(out, "  if earlier ticks make these hold: {}", earlier.join(", "))?;
                    }
                }
            }
        }
        Ok(())
    }

    fn json(&self, with_pairs: bool) -> Result<Value, Failure> {
        let names = |ids: &[PredicateId]| ids.iter().map(|id| self.name(*id).to_owned()).collect::<Vec<_>>();
        let map = |map: &ConceptMap| {
            let images = map.images.iter().enumerate();
            let images = images.map(|(at, image)| (self.concept(at).to_owned(), json!(self.image(*image))));
            let confused = map.confused.iter().enumerate().filter(|(_, confused)| **confused);
            json!({
                "images": images.collect::<serde_json::Map<String, Value>>(),
                "confused": confused.map(|(at, _)| self.concept(at)).collect::<Vec<_>>(),
            })
        };
        let mut answer = json!({
            "concepts": names(&self.found.concepts),
            "unread": names(&self.found.unread),
            "given": names(&self.found.given),
            "entities": self.options.entities_max,
            "maps": self.found.maps.len(),
            "shortcuts": self.shortcuts().map(map).collect::<Vec<_>>(),
            "complete": self.found.stopped.is_none(),
            "labels": self.labels(),
        });
        if with_pairs {
            let pairs = self.pairs().map(|pair| {
                let ([one, other], found) = pair?;
                let decided = found.is_ok();
                let witness = found.ok().flatten().map(|found| {
                    json!({
                        "scene": scene_json(&found.scene, &[self.rules]),
                        "earlier": earlier_facts(&found.scene, self.rules),
                        "decisions": found.decisions.map(|decision| decision.map(|action| self.name(action))),
                    })
                });
                let concepts = [self.concept(one), self.concept(other)];
                Ok(json!({ "concepts": concepts, "decided": decided, "witness": witness }))
            });
            answer["pairs"] = pairs.collect::<Result<Vec<Value>, Failure>>()?.into();
        }
        Ok(answer)
    }
}

/// Returns a set of at most this many elements that hits all sets.
fn hit(sets: &[BTreeSet<usize>], size: usize) -> Option<Vec<usize>> {
    let Some((first, rest)) = sets.split_first() else {
        return Some(Vec::new());
    };
    let size = size.checked_sub(1)?;
    first.iter().find_map(|element| {
        let open: Vec<BTreeSet<usize>> = rest.iter().filter(|set| !set.contains(element)).cloned().collect();
        let mut chosen = hit(&open, size)?;
        chosen.insert(0, *element);
        Some(chosen)
    })
}
