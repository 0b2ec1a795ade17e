//! Declarations: predicates and their directives. `types` declares the types.

mod types;

use std::collections::{HashMap, HashSet};

use crate::codes;
use crate::diag::{self, Diagnostic, Faults, Span, counted, did_you_mean};
use crate::eqrel::EQREL;

use crate::check::Policy;
use crate::check::rules::{
    self, Column, Directive, Predicate, PredicateId, RECORDS, RecordShape, RowEncoding, RowFormat, RowPlace, Type,
    TypeId, UserFunctor,
};
use crate::syntax::ast::BaseType;
use crate::syntax::ast::{Decl, FunctorDecl, Item, Mark, MarkKind, Name, Pragma};
use crate::syntax::include::Offered;

/// Maximum number of columns of a predicate.
const MAX_COLUMNS: usize = 64;

/// Maximum number of unknown names with a suggestion. A source with more errors gains nothing from suggestions.
const MAX_SUGGESTIONS: usize = 30;

/// Maximum number of uses shown for one unknown name.
const MAX_USES_SHOWN: usize = 4;

/// The data about a predicate that the checks need besides its [`Predicate`].
#[derive(Clone, Debug)]
pub(crate) struct Signature {
    /// The column types as far as known; `None` if the columns did not parse.
    pub columns: Option<Vec<Option<TypeId>>>,
    /// The `.input` directive that names it.
    pub input: Option<Span>,
}

/// All declared names. The maps serve lookups only and are never iterated.
pub(crate) struct Names {
    pub types: Vec<Type>,
    pub predicates: Vec<Predicate>,
    pub signatures: Vec<Signature>,
    /// The place of each type's declaration, for labels; `None` for base types.
    type_spans: Vec<Option<Span>>,
    type_by_name: HashMap<String, Option<TypeId>>,
    /// The places of all type declarations, also of aliases.
    declared_types: HashMap<String, Span>,
    /// The types and places of the branches of algebraic data types; `None` for a faulty type.
    branches: indexmap::IndexMap<String, (Option<TypeId>, Span)>,
    /// Whether a type is declared in the notation of older versions of Soufflé.
    pub has_old_types: bool,
    /// The declared functors.
    pub functors: Vec<UserFunctor>,
    /// The positions of functors among them; `None` for a faulty declaration.
    functor_by_name: HashMap<String, Option<u32>>,
    predicate_by_name: HashMap<String, PredicateId>,
    /// The `.printsize` directive of each predicate.
    printsizes: HashMap<PredicateId, Span>,
    /// The number of declared predicates. The hidden ones follow them.
    declared: usize,
    unknown: Unknown,
    /// Whether all declarations are known. If not, the checker reports no unknown names.
    complete: bool,
    /// What the checker permits.
    pub policy: Policy,
    /// By [`PredicateId`]: the component of each declared predicate. Predicates of one component depend on each other.
    pub components: Vec<usize>,
}

/// Unknown names with their uses, in the order of first use.
#[derive(Default)]
struct Unknown {
    predicates: indexmap::IndexMap<String, Vec<Span>>,
    types: indexmap::IndexMap<String, Vec<Span>>,
}

pub(crate) fn declare(items: &[Item], complete: bool, policy: Policy, faults: &mut Faults) -> Names {
    let mut names = Names {
        types: Vec::new(),
        predicates: Vec::new(),
        signatures: Vec::new(),
        type_spans: Vec::new(),
        type_by_name: HashMap::new(),
        declared_types: HashMap::new(),
        branches: indexmap::IndexMap::new(),
        has_old_types: false,
        functors: Vec::new(),
        functor_by_name: HashMap::new(),
        predicate_by_name: HashMap::new(),
        printsizes: HashMap::new(),
        declared: 0,
        unknown: Unknown::default(),
        complete,
        policy,
        components: Vec::new(),
    };
    names.declare_types(items, faults);
    for item in items {
        if let Item::Decl(decl) = item {
            names.declare_predicates(decl, faults);
        }
    }
    names.declared = names.predicates.len();
    for item in items {
        if let Item::Functor(decl) = item {
            names.declare_functor(decl, faults);
        }
    }
    for item in items {
        if let Item::Mark(mark) = item {
            names.mark(mark, faults);
        }
    }
    names.pragmas(items, faults);
    names
}

/// Returns the predicates that a declaration with the qualifier names.
fn qualified<'i>(items: &'i [Item], qualifier: &str) -> HashSet<&'i str> {
    let has = |decl: &&Decl| decl.qualifiers.iter().any(|word| word.text == qualifier);
    let decls = items.iter().filter_map(|item| match item {
        Item::Decl(decl) => Some(decl),
        _ => None,
    });
    let names = decls.filter(has).flat_map(|decl| &decl.names);
    names.map(|name| name.text.as_str()).collect()
}

impl Names {
    /// Returns the predicate with that name. Records an unknown name for [`Names::report_unknown`].
    pub fn resolve(&mut self, name: &Name) -> Option<PredicateId> {
        let known = self.find(&name.text);
        if known.is_none() {
            remember(&mut self.unknown.predicates, name);
        }
        known
    }

    fn declare_functor(&mut self, decl: &FunctorDecl, faults: &mut Faults) {
        let name = &decl.name.text;
        if let Some(known) = self.functor_by_name.get(name) {
            let earlier = known.map(|at| &self.functors[at as usize]);
            // Several files may declare a functor that they share.
            let is_same = |earlier: &UserFunctor| {
                let bases = earlier.arguments.iter().map(|argument| argument.ty);
                let again: Vec<Option<TypeId>> =
                    decl.arguments.iter().map(|(_, ty)| self.find_type(&ty.text)).collect();
                bases.map(Some).eq(again) && self.find_type(&decl.result.text) == Some(earlier.result)
            };
            if let Some(earlier) = earlier.filter(|earlier| !is_same(earlier)) {
                let message = format!("the functor `{name}` is declared twice");
                let fault = Diagnostic::new(codes::DUPLICATE_DECLARATION, message)
                    .at(decl.name.place.0, "declared again here")
                    .also(earlier.span, "first declared here");
                faults.push(fault);
            }
            return;
        }
        let result = self.type_named(&decl.result);
        let mut arguments = Vec::new();
        for (at, (argument, ty)) in decl.arguments.iter().enumerate() {
            let Some(ty) = self.type_named(ty) else { continue };
            arguments.push(Column {
                name: argument
                    .as_ref()
                    .map_or_else(|| format!("x{}", at + 1), |name| name.text.clone()),
                ty,
                base: self.base(ty),
            });
        }
        let known = result
            .filter(|_| arguments.len() == decl.arguments.len())
            .map(|result| {
                self.functors.push(UserFunctor {
                    name: name.clone(),
                    arguments,
                    result,
                    base: self.base(result),
                    doc: decl.doc.clone(),
                    span: decl.name.place.0,
                    definition: None,
                });
                u32::try_from(self.functors.len() - 1).expect("fewer than 2^32 functors")
            });
        self.functor_by_name.insert(name.clone(), known);
    }

    /// Returns the type with that name, if it is known.
    fn find_type(&self, name: &str) -> Option<TypeId> {
        self.type_by_name.get(name).copied().flatten()
    }

    /// Returns the position of the functor with that name, `None` if its declaration is faulty; `Err` with a similar name
    /// if there is none.
    pub fn functor(&self, name: &str) -> Result<Option<u32>, Option<String>> {
        match self.functor_by_name.get(name) {
            Some(known) => Ok(*known),
            None => {
                let all = self.functors.iter().map(|functor| functor.name.as_str());
                Err(did_you_mean(name, all).map(str::to_owned))
            }
        }
    }

    /// Returns the predicate with that name, if it is declared.
    pub fn find(&self, name: &str) -> Option<PredicateId> {
        self.predicate_by_name.get(name).copied()
    }

    /// Returns whether all declarations are known.
    pub fn complete(&self) -> bool {
        self.complete
    }

    pub fn predicate(&self, id: PredicateId) -> &Predicate {
        &self.predicates[id.index()]
    }

    /// Returns the id of the base type.
    pub fn base_type(base: BaseType) -> TypeId {
        match base {
            BaseType::Symbol => TypeId(0),
            BaseType::Number => TypeId(1),
            BaseType::Record => RECORDS,
            BaseType::Unsigned => TypeId(2),
            BaseType::Float => TypeId(3),
        }
    }

    /// Returns the number of hidden predicates.
    pub fn hidden(&self) -> usize {
        self.predicates.len() - self.declared
    }

    /// Adds a hidden predicate with these columns.
    pub fn hide(&mut self, columns: Vec<(String, TypeId)>, doc: String, span: Span) -> PredicateId {
        let predicate = PredicateId(u32::try_from(self.predicates.len()).expect("fewer than 2^32 predicates"));
        self.signatures.push(Signature {
            columns: Some(columns.iter().map(|(_, ty)| Some(*ty)).collect()),
            input: None,
        });
        let column = |(name, ty)| Column {
            name,
            ty,
            base: self.base(ty),
        };
        let columns = columns.into_iter().map(column).collect();
        let name = format!("+{}", self.hidden() + 1);
        self.predicates.push(Predicate::made(name, columns, doc, span));
        predicate
    }

    pub fn type_name(&self, id: TypeId) -> &str {
        &self.types[id.0 as usize].name
    }

    pub fn base(&self, id: TypeId) -> BaseType {
        self.types[id.0 as usize].base
    }

    /// Returns the type with this branch, `None` if that is faulty; `Err` with a similar name if there is none.
    pub fn branch(&self, name: &str) -> Result<Option<TypeId>, Option<String>> {
        match self.branches.get(name) {
            Some((ty, _)) => Ok(*ty),
            None => Err(did_you_mean(name, self.branches.keys().map(String::as_str)).map(str::to_owned)),
        }
    }

    /// Returns the shapes of the records of a type.
    pub fn shapes(&self, id: TypeId) -> &[RecordShape] {
        rules::shapes(&self.types, id)
    }

    /// Returns the names of the types that a declaration can name.
    fn type_names(&self) -> impl Iterator<Item = &str> {
        let nameable = |ty: &&Type| self.type_by_name.contains_key(&ty.name);
        self.types.iter().filter(nameable).map(|ty| ty.name.as_str())
    }

    /// Returns whether every value of type `sub` has type `sup`.
    pub fn is_subtype(&self, sub: TypeId, sup: TypeId) -> bool {
        let members = |id: TypeId| &self.types[id.0 as usize].members;
        let parent = |id: &TypeId| self.types[id.0 as usize].parent;
        let mut ancestors = std::iter::successors(Some(sub), parent);
        // The members of a union are no unions.
        ancestors.any(|id| id == sup || members(sup).contains(&id))
            || !members(sub).is_empty() && members(sub).iter().all(|&member| self.is_subtype(member, sup))
    }

    /// Returns the narrower of two comparable types, or a member that two types share; `None` if they have no value in
    /// common.
    pub fn meet(&self, a: TypeId, b: TypeId) -> Option<TypeId> {
        if a == b || self.is_subtype(a, b) {
            return Some(a);
        }
        if self.is_subtype(b, a) {
            return Some(b);
        }
        let members = |id: TypeId| self.types[id.0 as usize].members.iter();
        let parts = members(a)
            .map(|&part| (part, b))
            .chain(members(b).map(|&part| (part, a)));
        parts.into_iter().find_map(|(part, other)| self.meet(part, other))
    }

    /// `P(x: agent, y: agent)`
    pub fn signature_text(&self, id: PredicateId) -> String {
        let predicate = self.predicate(id);
        let columns: Vec<String> = (predicate.columns.iter())
            .map(|column| format!("{}: {}", column.name, self.type_name(column.ty)))
            .collect();
        format!("{}({})", predicate.name, columns.join(", "))
    }

    fn declare_predicates(&mut self, decl: &Decl, faults: &mut Faults) {
        let mut columns = Vec::new();
        let mut types = Vec::new();
        let mut seen: HashMap<&str, Span> = HashMap::new();
        for column in decl.columns.iter().flatten() {
            let span = column.name.place.0;
            if let Some(&first) = seen.get(column.name.text.as_str()) {
                let message = format!("two columns are named `{}`", column.name.text);
                let fault = Diagnostic::new(codes::DUPLICATE_DECLARATION, message)
                    .at(span, "named again here")
                    .also(first, "first named here");
                faults.push(fault);
            }
            seen.insert(&column.name.text, span);
            let ty = self.type_named(&column.ty);
            types.push(ty);
            let ty = ty.unwrap_or(TypeId(0));
            columns.push(Column {
                name: column.name.text.clone(),
                ty,
                base: self.base(ty),
            });
        }
        if columns.len() > MAX_COLUMNS {
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, format!("{} columns", columns.len()))
                .at(decl.names[0].place.0, "")
                .note(format!("a predicate has at most {MAX_COLUMNS}"));
            faults.push(fault);
        }
        qualifiers(&decl.qualifiers, faults);
        let choices = choices(decl, faults);
        for name in &decl.names {
            let span = name.place.0;
            if let Some(&earlier) = self.declared_types.get(&name.text) {
                let message = format!("`{}` is a type and a predicate", name.text);
                let fault = Diagnostic::new(codes::DUPLICATE_DECLARATION, message)
                    .at(span, "declared as a predicate here")
                    .also(earlier, "declared as a type here")
                    .help("give one of them another name");
                faults.push(fault);
            }
            if let Some(&earlier) = self.predicate_by_name.get(&name.text) {
                let message = format!("the predicate `{}` is declared twice", name.text);
                let fault = Diagnostic::new(codes::DUPLICATE_DECLARATION, message)
                    .at(span, "declared again here")
                    .also(self.predicate(earlier).span, "first declared here");
                faults.push(fault);
                continue;
            }
            let id = PredicateId(u32::try_from(self.predicates.len()).expect("fewer than 2^32 predicates"));
            let has = |wanted: &str| decl.qualifiers.iter().any(|word| word.text == wanted);
            self.predicate_by_name.insert(name.text.clone(), id);
            self.predicates.push(Predicate {
                name: name.text.clone(),
                columns: columns.clone(),
                doc: decl.doc.clone(),
                span,
                input: false,
                edb: None,
                output: false,
                printsize: false,
                derived: false,
                hidden: false,
                inline: has("inline") && !has("no_inline"),
                magic: has("magic") && !has("no_magic"),
                parameters: 0,
                choices: choices.clone(),
                subsumption: None,
                numbering: None,
                size_limit: None,
                directives: Vec::new(),
            });
            self.signatures.push(Signature {
                columns: decl.columns.is_some().then(|| types.clone()),
                input: None,
            });
        }
    }

    /// Applies `.pragma "magic-transform" "A,B"`, where `*` names all predicates. Reports names without a declaration
    /// and warns of other pragmas.
    fn pragmas(&mut self, items: &[Item], faults: &mut Faults) {
        let excluded = qualified(items, "no_magic");
        let mut all = false;
        let pragmas = items.iter().filter_map(|item| match item {
            Item::Pragma(pragma) => Some(pragma),
            _ => None,
        });
        for pragma in pragmas {
            let named = match pragma.words.as_slice() {
                [key, named] if key == "magic-transform" => named,
                _ => {
                    faults.push(no_effect(pragma));
                    continue;
                }
            };
            for name in named.split(',').map(str::trim).filter(|name| !name.is_empty()) {
                if name == "*" {
                    all = true;
                } else if let Some(id) = self.find(name) {
                    self.predicates[id.index()].magic = !excluded.contains(name);
                } else if self.complete {
                    let message = format!("`.pragma` names `{name}`, which is not declared");
                    let fault = Diagnostic::new(codes::IGNORED, message).at(pragma.place.0, "");
                    faults.push(fault.help("write the name of a predicate, or `*` for all"));
                }
            }
        }
        for predicate in self.predicates.iter_mut().filter(|_| all) {
            predicate.magic |= !excluded.contains(predicate.name.as_str());
        }
    }

    fn mark(&mut self, mark: &Mark, faults: &mut Faults) {
        if mark.kind == MarkKind::LimitSize {
            let limit = size_limit(mark, faults);
            for name in &mark.names {
                if let Some(id) = self.resolve(name) {
                    let predicate = &mut self.predicates[id.index()];
                    predicate.size_limit = predicate.size_limit.min(limit).or(limit);
                }
            }
            return;
        }
        let directive = read_options(mark, faults);
        for name in &mark.names {
            let Some(id) = self.resolve(name) else { continue };
            let predicate = &mut self.predicates[id.index()];
            match mark.kind {
                MarkKind::Input => {
                    predicate.input = true;
                    self.signatures[id.index()].input.get_or_insert(name.place.0);
                }
                MarkKind::Output => predicate.output = true,
                _ => {
                    predicate.printsize = true;
                    if let Some(earlier) = self.printsizes.insert(id, name.place.0) {
                        let message = format!("`{}` has two `.printsize` directives", name.text);
                        let fault = Diagnostic::new(codes::DUPLICATE_DECLARATION, message)
                            .at(name.place.0, "again here")
                            .also(earlier, "first here");
                        faults.push(fault.help("remove one of them"));
                    }
                }
            }
            let (columns, chosen) = (predicate.arity(), directive.format.columns.len());
            if let Some(option) = mark.options.iter().find(|option| option.key.text == "columns")
                && chosen != columns
                && chosen > 0
            {
                let chosen = counted(chosen, "column");
                let message = format!("`columns` names {chosen}, `{}` has {columns}", predicate.name);
                let fault = Diagnostic::new(codes::ARITY_MISMATCH, message).at(option.place.0, "");
                faults.push(fault.also(predicate.span, "declared here"));
            }
            let file = mark.options.iter().rfind(|option| option.key.text == "filename");
            predicate.directives.push(Directive {
                span: file.map_or(name.place.0, |file| file.place.0),
                ..directive.clone()
            });
        }
    }

    // --- unknown names

    /// Reports each unknown name once, with the places of its uses. `offered` names built-in files that declare some.
    pub fn report_unknown(&mut self, offered: &Offered, faults: &mut Faults) {
        let unknown = std::mem::take(&mut self.unknown);
        if !self.complete {
            return;
        }
        let include = |name: &String| {
            let file = offered.get(name)?;
            Some(format!("add `.include \"{file}\"`, which declares it"))
        };
        for (index, (name, uses)) in unknown.types.iter().enumerate() {
            let fault = Diagnostic::new(codes::UNKNOWN_TYPE, format!("no type `{name}` is declared"));
            let mut fault = with_uses(fault, uses);
            let candidates = self.type_names();
            let near = suggestion(index, name, candidates);
            fault = match near {
                Some(near) => {
                    let id = self.types.iter().position(|ty| ty.name == near);
                    if let Some(span) = id.and_then(|id| self.type_spans[id]) {
                        fault = fault.also(span, format!("`{near}` is declared here"));
                    }
                    let fault = fault.did_you_mean(near, uses);
                    include(name)
                        .into_iter()
                        .fold(fault, |fault, include| fault.help(format!("or {include}")))
                }
                None if offered.contains_key(name) => fault.help(include(name).unwrap_or_default()),
                None => match BaseType::of_other_languages(name) {
                    Some(base) => {
                        let edits = uses.iter().map(|&place| (place, base.name().to_owned()));
                        let title = format!("write `{}`", base.name());
                        fault.help(title.clone()).fix(title, edits)
                    }
                    None => {
                        let known: Vec<String> = self.type_names().map(|name| format!("`{name}`")).collect();
                        let own = format!("declare it: `.type {name} <: symbol`");
                        match known.len() {
                            0 | 9.. => fault.help(own),
                            _ => fault.help(format!("the types are {}; or {own}", known.join(", "))),
                        }
                    }
                },
            };
            faults.push(fault);
        }
        for (index, (name, uses)) in unknown.predicates.iter().enumerate() {
            let fault = Diagnostic::new(codes::UNKNOWN_PREDICATE, format!("no predicate `{name}` is declared"));
            let mut fault = with_uses(fault, uses);
            let declared = self.predicates.iter().filter(|predicate| !predicate.hidden);
            let candidates = declared.map(|predicate| predicate.name.as_str());
            let near = suggestion(index, name, candidates);
            fault = match near {
                Some(near) => {
                    let span = self.predicate_by_name.get(near).map(|&id| self.predicate(id).span);
                    if let Some(span) = span {
                        fault = fault.also(span, format!("`{near}` is declared here"));
                    }
                    let fault = fault.did_you_mean(near, uses);
                    include(name)
                        .into_iter()
                        .fold(fault, |fault, include| fault.help(format!("or {include}")))
                }
                None => fault.help(include(name).unwrap_or_else(|| {
                    format!(
                        "declare it: `.decl {name}(...)`, with `.input {name}` if its facts are given, or include the \
                         file that declares it"
                    )
                })),
            };
            faults.push(fault);
        }
    }
}

/// Returns the keys of a predicate as positions of columns.
fn choices(decl: &Decl, faults: &mut Faults) -> Vec<Vec<usize>> {
    let columns = decl.columns.as_deref().unwrap_or_default();
    let mut found = Vec::new();
    for key in &decl.choices {
        let mut positions = Vec::new();
        for name in key {
            match columns.iter().position(|column| column.name.text == name.text) {
                Some(at) => positions.push(at),
                None if decl.columns.is_none() => {}
                None => {
                    let message = format!("`{}` has no column `{}`", decl.names[0].text, name.text);
                    let fault = Diagnostic::new(codes::UNKNOWN_COLUMN, message)
                        .at(name.place.0, "")
                        .also(decl.names[0].place.0, "declared here");
                    let near = did_you_mean(&name.text, columns.iter().map(|column| column.name.text.as_str()));
                    faults.push(match near {
                        Some(near) => fault.did_you_mean(near, &[name.place.0]),
                        None => fault.help("name a column of the declaration"),
                    });
                }
            }
        }
        if positions.len() == key.len() {
            positions.sort_unstable();
            positions.dedup();
            found.push(positions);
        }
    }
    found
}

/// Returns the `n` of `.limitsize P(n=10)`.
fn size_limit(mark: &Mark, faults: &mut Faults) -> Option<usize> {
    let mut limit = None;
    for option in &mark.options {
        match (option.key.text.as_str(), option.value.parse::<usize>()) {
            ("n", Ok(rows)) => limit = Some(rows),
            ("n", Err(_)) => {
                let message = format!("`n={}` is no number of rows", option.value);
                faults.push(
                    Diagnostic::new(codes::SYNTAX, message)
                        .at(option.place.0, "")
                        .help("write `n=1000`"),
                );
                return None;
            }
            (other, _) => {
                let fault = Diagnostic::new(codes::IGNORED, format!("`{other}` has no effect"));
                faults.push(fault.at(option.key.place.0, "").help("`.limitsize` has the option `n`"));
            }
        }
    }
    if limit.is_none() {
        let names: Vec<&str> = mark.names.iter().map(|name| name.text.as_str()).collect();
        let names = names.join(", ");
        let message = format!("`.limitsize {names}` has no limit");
        let fault = Diagnostic::new(codes::SYNTAX, message).at(mark.names[0].place.0, "");
        faults.push(fault.help(format!("write the number of rows: `.limitsize {names}(n=1000)`")));
    }
    limit
}

fn no_effect(pragma: &Pragma) -> Diagnostic {
    (Diagnostic::new(codes::IGNORED, "`.pragma` has no effect").at(pragma.place.0, ""))
        .help("remove it; only `.pragma \"magic-transform\" \"A,B\"` has one")
}

/// The qualifiers that have an effect.
const EFFECTIVE: [&str; 5] = ["inline", "no_inline", "magic", "no_magic", EQREL];

/// Reports qualifiers that repeat or contradict another one, and warns of those without effect. They ask for a way of
/// evaluation, which never changes an answer.
fn qualifiers(words: &[Name], faults: &mut Faults) {
    let storage = |word: &Name| matches!(word.text.as_str(), "btree" | "btree_delete" | "brie" | EQREL);
    let rivals = |a: &Name, b: &Name| a.text == b.text || (storage(a) && storage(b));
    for (index, word) in words.iter().enumerate() {
        if let Some(earlier) = words[..index].iter().find(|earlier| rivals(earlier, word)) {
            let fault = Diagnostic::new(
                codes::DUPLICATE_DECLARATION,
                format!("`{}` after `{}`", word.text, earlier.text),
            )
            .at(word.place.0, "")
            .also(earlier.place.0, "one of them is enough");
            faults.push(fault.help("remove one of them"));
        } else if !EFFECTIVE.contains(&word.text.as_str())
            && !words[index + 1..].iter().any(|later| rivals(word, later))
        {
            let fault = Diagnostic::new(codes::IGNORED, format!("`{}` has no effect", word.text));
            faults.push(fault.at(word.place.0, "").remove(word.place.0));
        }
    }
}

/// Number of recent uses compared for duplicates.
const MAX_USES_REMEMBERED: usize = 8;

/// Records a use once, although the checker visits a clause with alternatives several times.
fn remember(unknown: &mut indexmap::IndexMap<String, Vec<Span>>, name: &Name) {
    let places = unknown.entry(name.text.clone()).or_default();
    if !places
        .iter()
        .rev()
        .take(MAX_USES_REMEMBERED)
        .any(|place| *place == name.place.0)
    {
        places.push(name.place.0);
    }
}

/// The options of `.input` and `.output`, for suggestions.
const FILE_OPTIONS: [&str; 8] = [
    "IO",
    "columns",
    "compress",
    "delimiter",
    "filename",
    "format",
    "headers",
    "rfc4180",
];

/// Reads the options of an `.input`, `.output` or `.printsize` directive.
fn read_options(mark: &Mark, faults: &mut Faults) -> Directive {
    let mut place = RowPlace::Usual;
    let mut format = RowFormat::default();
    let mut delimiter = None;
    let mut terminal = false;
    let mut compress = false;
    let mut json = false;
    let mut encoded = None;
    for option in &mark.options {
        let flag = option.value == "true";
        if ["compress", "headers", "rfc4180"].contains(&option.key.text.as_str())
            && !["true", "false"].contains(&option.value.as_str())
        {
            let message = format!("`{}={}` means `false`", option.key.text, option.value);
            let fault = Diagnostic::new(codes::IGNORED, message).at(option.place.0, "");
            faults.push(fault.help("write `true` or `false`"));
        }
        match option.key.text.as_str() {
            "IO" => match (mark.kind, option.value.as_str()) {
                (MarkKind::Input | MarkKind::Output, "file") | (MarkKind::PrintSize, "stdoutprintsize") => {}
                (MarkKind::Input | MarkKind::Output, "jsonfile") => json = true,
                (MarkKind::Input, "stdin") | (MarkKind::Output, "stdout") => terminal = true,
                (_, value) => {
                    let fault = Diagnostic::new(codes::UNSUPPORTED, format!("`IO={value}` is not supported here"));
                    let known = match mark.kind {
                        MarkKind::Input => "`file`, `jsonfile`, `stdin` or `format=parquet`",
                        MarkKind::Output => "`file`, `jsonfile`, `stdout` or `format=parquet`",
                        _ => "`stdoutprintsize`",
                    };
                    faults.push(fault.at(option.place.0, "").help(format!("use {known}")));
                }
            },
            "filename" if mark.kind != MarkKind::PrintSize => {
                if let Some(reason) = faulty_name(&option.value, mark.kind) {
                    let fault = Diagnostic::new(codes::INVALID_OUTPUT, reason).at(option.place.0, "");
                    faults.push(fault.help("write a name such as `rows.csv` or `folder/rows.csv`"));
                }
                place = RowPlace::File(option.value.clone());
            }
            "delimiter" if option.value.is_empty() => {
                faults.push(Diagnostic::new(codes::SYNTAX, "empty delimiter").at(option.place.0, ""));
            }
            "delimiter" => delimiter = Some(option.value.clone()),
            "headers" => format.headers = flag,
            "rfc4180" => format.quoted = flag,
            "columns" if mark.kind == MarkKind::Input => match column_numbers(&option.value) {
                Some(numbers) => format.columns = numbers,
                None => {
                    let fault = Diagnostic::new(codes::SYNTAX, "not a list of columns").at(option.place.0, "");
                    faults.push(fault.help("list each column number once, counted from 0: `columns=\"0:2:1\"`"));
                }
            },
            "format" if mark.kind != MarkKind::PrintSize => encoded = Some(option),
            "compress" if mark.kind != MarkKind::PrintSize => compress = flag,
            "dbname" => {
                let fault = Diagnostic::new(codes::UNSUPPORTED, "the option `dbname` is not supported");
                let help = "keep the rows of each table in a file: `sqlite3 -tabs FILE 'SELECT * FROM A' > A.facts`";
                faults.push(fault.at(option.key.place.0, "").help(help));
            }
            key => {
                let fault = Diagnostic::new(codes::IGNORED, format!("the option `{key}` has no effect"));
                let fault = fault.at(option.key.place.0, "");
                faults.push(match did_you_mean(key, FILE_OPTIONS) {
                    Some(near) => fault.help(format!("did you mean `{near}`?")),
                    None => fault.help("remove it"),
                });
            }
        }
    }
    let named = matches!(&place, RowPlace::File(name) if name.ends_with(".parquet"));
    let encoding = match (json, encoded.map(|option| option.value.as_str())) {
        (true, None | Some("list")) => RowEncoding::Json { objects: false },
        (true, Some("object")) => RowEncoding::Json { objects: true },
        (false, None) if named && !terminal => RowEncoding::Parquet,
        (false, None | Some("text")) => RowEncoding::Text,
        (false, Some("parquet")) if !terminal => RowEncoding::Parquet,
        (_, Some(value)) => {
            let (what, known) = match (json, terminal) {
                (true, _) => ("JSON", "`list` or `object`"),
                (false, true) => ("a stream", "`text`"),
                (false, false) => ("a file", "`text` or `parquet`, or `IO=jsonfile`"),
            };
            let message = format!("`format={value}` is not supported for {what}");
            let place = encoded.map_or(mark.names[0].place.0, |option| option.place.0);
            let fault = Diagnostic::new(codes::UNSUPPORTED, message).at(place, "");
            faults.push(fault.help(format!("use {known}")));
            RowEncoding::Text
        }
    };
    if encoding != RowEncoding::Text {
        let of_text = ["columns", "delimiter", "headers", "rfc4180"];
        let useless = |key: &str| of_text.contains(&key) || (key == "compress" && encoding == RowEncoding::Parquet);
        for option in mark.options.iter().filter(|option| useless(&option.key.text)) {
            let message = format!("the option `{}` is only for rows as text", option.key.text);
            let fault = Diagnostic::new(codes::IGNORED, message);
            faults.push(fault.at(option.key.place.0, "").help("remove it"));
        }
        format.columns.clear();
    }
    let usual = if format.quoted { "," } else { "\t" };
    format.delimiter = delimiter.unwrap_or_else(|| usual.to_owned());
    if terminal {
        place = RowPlace::Terminal;
    }
    Directive {
        kind: mark.kind,
        place,
        encoding,
        format,
        compress,
        span: mark.names[0].place.0,
    }
}

/// Returns why a text is no name of an output that means the same on every system.
fn faulty_name(name: &str, kind: MarkKind) -> Option<&'static str> {
    let drive = |name: &str| name.len() > 1 && name.as_bytes()[1] == b':' && name.as_bytes()[0].is_ascii_alphabetic();
    match name.rsplit('/').next().unwrap_or_default() {
        _ if kind != MarkKind::Output => None,
        "" if name.is_empty() => Some("the name of the file is empty"),
        "" | "." | ".." => Some("the name is that of a folder"),
        _ if name.contains(|c: char| c.is_control()) => Some("the name of the file contains a control character"),
        _ if name.contains('\\') || drive(name) => Some("the name of the file is a path of one system only"),
        _ => None,
    }
}

/// `0:2:1`
fn column_numbers(text: &str) -> Option<Vec<usize>> {
    let numbers: Vec<usize> = text
        .split(':')
        .map(|number| number.trim().parse::<u16>().ok().map(usize::from))
        .collect::<Option<_>>()?;
    let different: HashSet<&usize> = numbers.iter().collect();
    (different.len() == numbers.len()).then_some(numbers)
}

/// Returns the candidate closest to an unknown name, for the first of these names.
fn suggestion<'a>(index: usize, name: &str, candidates: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    if index < MAX_SUGGESTIONS {
        did_you_mean(name, candidates)
    } else {
        None
    }
}

fn with_uses(mut fault: Diagnostic, uses: &[Span]) -> Diagnostic {
    for (index, &span) in uses.iter().take(MAX_USES_SHOWN).enumerate() {
        fault = if index == 0 {
            fault.at(span, "")
        } else {
            fault.also(span, "also used here")
        };
    }
    if uses.len() > MAX_USES_SHOWN {
        let more = counted(uses.len() - MAX_USES_SHOWN, "more place");
        fault = fault.note(format!("it is used in {more}"));
    }
    fault
}
