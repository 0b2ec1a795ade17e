//! Types and predicates: who is declared, as what.

use std::collections::HashMap;

use crate::diag::{Code, Diagnostic, Span, did_you_mean};

use super::ast::{Decl, Item, MarkKind, Name, TypeDecl, TypeDefinition};
use super::faults::Faults;
use super::rules::{BaseType, Column, RelId, Relation, Type, TypeId};

/// More columns than this are refused.
const MAX_COLUMNS: usize = 64;

/// A longer chain of subtypes is refused.
const MAX_TYPE_DEPTH: usize = 64;

/// For so many unknown names a similar one is looked for; beyond that the text is too strange for it to help.
const MAX_SUGGESTIONS: usize = 30;

/// Of the places where an unknown name is used, so many are shown.
const MAX_USES_SHOWN: usize = 4;

/// What the checks know of a predicate besides its [`Relation`].
#[derive(Clone, Debug)]
pub(super) struct Signature {
    /// The column types as far as they are known; `None` if the columns were not understood.
    pub columns: Option<Vec<Option<TypeId>>>,
    /// The `.input` that names it.
    pub input: Option<Span>,
}

/// All declared names. The maps are only asked, never walked.
pub(super) struct Names {
    pub types: Vec<Type>,
    pub relations: Vec<Relation>,
    pub signatures: Vec<Signature>,
    /// Where each type is declared, for labels; none for `symbol` and `number`.
    type_spans: Vec<Option<Span>>,
    type_by_name: HashMap<String, Option<TypeId>>,
    relation_by_name: HashMap<String, RelId>,
    unknown: Unknown,
    /// Whether every declaration was read; if not, unknown names are not reported.
    complete: bool,
}

/// Unknown names and where they are used, in the order of first use.
#[derive(Default)]
struct Unknown {
    predicates: indexmap::IndexMap<String, Vec<Span>>,
    types: indexmap::IndexMap<String, Vec<Span>>,
}

pub(super) fn declare(items: &[Item], complete: bool, faults: &mut Faults) -> Names {
    let mut names = Names {
        types: Vec::new(),
        relations: Vec::new(),
        signatures: Vec::new(),
        type_spans: Vec::new(),
        type_by_name: HashMap::new(),
        relation_by_name: HashMap::new(),
        unknown: Unknown::default(),
        complete,
    };
    names.declare_types(items, faults);
    for item in items {
        if let Item::Decl(decl) = item {
            names.declare_predicates(decl, faults);
        }
    }
    for item in items {
        if let Item::Mark(mark) = item {
            for name in &mark.names {
                names.mark(mark.kind, name);
            }
        }
    }
    names
}

impl Names {
    /// The predicate of that name; an unknown one is remembered for [`Names::report_unknown`].
    pub fn predicate(&mut self, name: &Name) -> Option<RelId> {
        let known = self.find(&name.text);
        if known.is_none() {
            self.unknown
                .predicates
                .entry(name.text.clone())
                .or_default()
                .push(name.place.0);
        }
        known
    }

    /// The predicate of that name, if it is declared.
    pub fn find(&self, name: &str) -> Option<RelId> {
        self.relation_by_name.get(name).copied()
    }

    /// Whether every declaration was read.
    pub fn complete(&self) -> bool {
        self.complete
    }

    pub fn relation(&self, id: RelId) -> &Relation {
        &self.relations[id.index()]
    }

    /// `symbol` or `number` itself.
    pub fn base_type(base: BaseType) -> TypeId {
        match base {
            BaseType::Symbol => TypeId(0),
            BaseType::Number => TypeId(1),
        }
    }

    pub fn type_name(&self, id: TypeId) -> &str {
        &self.types[id.0 as usize].name
    }

    pub fn base(&self, id: TypeId) -> BaseType {
        self.types[id.0 as usize].base
    }

    /// Whether every value of type `sub` is one of type `sup`.
    pub fn is_subtype(&self, sub: TypeId, sup: TypeId) -> bool {
        let mut at = Some(sub);
        while let Some(id) = at {
            if id == sup {
                return true;
            }
            at = self.types[id.0 as usize].parent;
        }
        false
    }

    /// The narrower of two types of one line; `None` if neither is a subtype of the other.
    pub fn meet(&self, a: TypeId, b: TypeId) -> Option<TypeId> {
        if self.is_subtype(a, b) {
            Some(a)
        } else if self.is_subtype(b, a) {
            Some(b)
        } else {
            None
        }
    }

    /// `P(x: agent, y: agent)`
    pub fn signature_text(&self, id: RelId) -> String {
        let relation = self.relation(id);
        let columns: Vec<String> = (relation.columns.iter())
            .map(|column| format!("{}: {}", column.name, self.type_name(column.ty)))
            .collect();
        format!("{}({})", relation.name, columns.join(", "))
    }

    // --- types

    fn declare_types(&mut self, items: &[Item], faults: &mut Faults) {
        for (name, base) in [("symbol", BaseType::Symbol), ("number", BaseType::Number)] {
            self.add_type(name, base, None, String::new());
        }
        let mut declared: Vec<&TypeDecl> = Vec::new();
        let mut first: HashMap<&str, &TypeDecl> = HashMap::new();
        for item in items {
            let Item::Type(decl) = item else { continue };
            let name = decl.name.text.as_str();
            if self.type_by_name.contains_key(name) {
                let fault = Diagnostic::new(Code::DuplicateDeclaration, format!("the type `{name}` is built in"))
                    .at(decl.name.place.0, "");
                faults.push(fault);
            } else if let Some(earlier) = first.get(name) {
                let fault = Diagnostic::new(
                    Code::DuplicateDeclaration,
                    format!("the type `{name}` is declared twice"),
                )
                .at(decl.name.place.0, "declared again here")
                .also(earlier.name.place.0, "first declared here");
                faults.push(fault);
            } else {
                first.insert(name, decl);
                declared.push(decl);
            }
        }
        // Every subtype gets its number before parents are looked up, so that declarations may come in any order.
        for decl in &declared {
            if let TypeDefinition::Subtype(_) = decl.definition {
                let id = self.add_type(
                    &decl.name.text,
                    BaseType::Symbol,
                    Some(decl.name.place.0),
                    decl.doc.clone(),
                );
                debug_assert_eq!(self.type_by_name[&decl.name.text], Some(id));
            }
        }
        for decl in &declared {
            match &decl.definition {
                TypeDefinition::Subtype(_) => {}
                TypeDefinition::Alias(_) => {
                    let target = self.alias_target(decl, &first, faults);
                    self.type_by_name.insert(decl.name.text.clone(), target);
                }
                TypeDefinition::Faulty => {
                    self.type_by_name.insert(decl.name.text.clone(), None);
                }
            }
        }
        let mut faulty = vec![false; self.types.len()];
        for decl in &declared {
            if let TypeDefinition::Subtype(parent) = &decl.definition
                && let Some(id) = self.type_by_name[&decl.name.text]
            {
                match self.type_named(parent) {
                    Some(parent) => self.types[id.0 as usize].parent = Some(parent),
                    None => faulty[id.0 as usize] = true,
                }
            }
        }
        self.settle_parents(&mut faulty, faults);
        for decl in &declared {
            if let Some(id) = self.type_by_name[&decl.name.text]
                && faulty[id.0 as usize]
            {
                self.type_by_name.insert(decl.name.text.clone(), None);
            }
        }
    }

    fn add_type(&mut self, name: &str, base: BaseType, span: Option<Span>, doc: String) -> TypeId {
        let id = TypeId(u32::try_from(self.types.len()).expect("fewer than 2^32 types"));
        self.types.push(Type {
            name: name.to_owned(),
            base,
            parent: None,
            doc,
        });
        self.type_spans.push(span);
        self.type_by_name.insert(name.to_owned(), Some(id));
        id
    }

    /// Follows `.type A = B`, `.type B = C` ... to a type.
    fn alias_target(
        &mut self,
        decl: &TypeDecl,
        first: &HashMap<&str, &TypeDecl>,
        faults: &mut Faults,
    ) -> Option<TypeId> {
        let mut at = decl;
        let mut steps = 0;
        while let TypeDefinition::Alias(other) = &at.definition {
            if let Some(known) = self.type_by_name.get(&other.text) {
                return *known;
            }
            steps += 1;
            at = match first.get(other.text.as_str()) {
                Some(next) if std::ptr::eq(*next, decl) => {
                    let message = format!("the type `{}` is declared by way of itself", decl.name.text);
                    faults.push(Diagnostic::new(Code::CyclicType, message).at(decl.name.place.0, ""));
                    return None;
                }
                Some(_) if steps > MAX_TYPE_DEPTH => {
                    let fault = Diagnostic::new(Code::LimitExceeded, "too long a chain of types")
                        .at(decl.name.place.0, "")
                        .note(format!("at most {MAX_TYPE_DEPTH} names may stand for each other"));
                    faults.push(fault);
                    return None;
                }
                Some(next) => next,
                None => return self.type_named(other),
            };
        }
        None
    }

    /// Finds the base of every type through its parents. Types on a cycle or under a faulty one become faulty.
    fn settle_parents(&mut self, faulty: &mut [bool], faults: &mut Faults) {
        // 0: not looked at; otherwise the distance from the base, plus one.
        let mut depth = vec![0_usize; self.types.len()];
        depth[0] = 1;
        depth[1] = 1;
        let mut reported_on = vec![usize::MAX; self.types.len()];
        for start in 2..self.types.len() {
            let mut path = Vec::new();
            let mut at = start;
            while depth[at] == 0 && !faulty[at] && reported_on[at] != start {
                reported_on[at] = start;
                path.push(at);
                match self.types[at].parent {
                    Some(parent) => at = parent.0 as usize,
                    None => break,
                }
            }
            let cyclic = depth[at] == 0 && !faulty[at];
            if cyclic {
                let cycle = &path[path.iter().position(|&id| id == at).unwrap_or(0)..];
                let name = &self.types[at].name;
                let mut fault = Diagnostic::new(Code::CyclicType, format!("the type `{name}` is a subtype of itself"));
                for (index, &id) in cycle.iter().enumerate() {
                    let Some(span) = self.type_spans[id] else { continue };
                    fault = if index == 0 {
                        fault.at(span, "")
                    } else {
                        fault.also(span, "on the circle")
                    };
                }
                faults.push(fault);
            }
            for &id in path.iter().rev() {
                let parent = self.types[id].parent.map_or(0, |parent| parent.0 as usize);
                if cyclic || faulty[parent] {
                    faulty[id] = true;
                    continue;
                }
                depth[id] = depth[parent] + 1;
                self.types[id].base = self.types[parent].base;
                if depth[id] > MAX_TYPE_DEPTH {
                    faulty[id] = true;
                    let mut fault = Diagnostic::new(Code::LimitExceeded, "too long a chain of subtypes")
                        .note(format!("a type has at most {MAX_TYPE_DEPTH} ancestors"));
                    if let Some(span) = self.type_spans[id] {
                        fault = fault.at(span, "");
                    }
                    faults.push(fault);
                }
            }
        }
        // Nobody may walk along a cycle later.
        for (id, ty) in self.types.iter_mut().enumerate() {
            if faulty[id] {
                ty.parent = None;
            }
        }
    }

    fn type_named(&mut self, name: &Name) -> Option<TypeId> {
        match self.type_by_name.get(&name.text) {
            Some(known) => *known,
            None => {
                self.unknown
                    .types
                    .entry(name.text.clone())
                    .or_default()
                    .push(name.place.0);
                None
            }
        }
    }

    // --- predicates

    fn declare_predicates(&mut self, decl: &Decl, faults: &mut Faults) {
        let mut columns = Vec::new();
        let mut types = Vec::new();
        let mut seen: HashMap<&str, Span> = HashMap::new();
        for column in decl.columns.iter().flatten() {
            let span = column.name.place.0;
            if let Some(&first) = seen.get(column.name.text.as_str()) {
                let message = format!("two columns are named `{}`", column.name.text);
                let fault = Diagnostic::new(Code::DuplicateDeclaration, message)
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
            let fault = Diagnostic::new(Code::LimitExceeded, format!("{} columns", columns.len()))
                .at(decl.names[0].place.0, "")
                .note(format!("a predicate has at most {MAX_COLUMNS}"));
            faults.push(fault);
        }
        for name in &decl.names {
            let span = name.place.0;
            if let Some(&earlier) = self.relation_by_name.get(&name.text) {
                let message = format!("the predicate `{}` is declared twice", name.text);
                let fault = Diagnostic::new(Code::DuplicateDeclaration, message)
                    .at(span, "declared again here")
                    .also(self.relation(earlier).span, "first declared here");
                faults.push(fault);
                continue;
            }
            let id = RelId(u32::try_from(self.relations.len()).expect("fewer than 2^32 predicates"));
            self.relation_by_name.insert(name.text.clone(), id);
            self.relations.push(Relation {
                name: name.text.clone(),
                columns: columns.clone(),
                doc: decl.doc.clone(),
                span,
                input: false,
                output: false,
                printsize: false,
                derived: false,
                hidden: false,
            });
            self.signatures.push(Signature {
                columns: decl.columns.is_some().then(|| types.clone()),
                input: None,
            });
        }
    }

    fn mark(&mut self, kind: MarkKind, name: &Name) {
        let Some(id) = self.predicate(name) else { return };
        let relation = &mut self.relations[id.index()];
        match kind {
            MarkKind::Input => {
                relation.input = true;
                self.signatures[id.index()].input.get_or_insert(name.place.0);
            }
            MarkKind::Output => relation.output = true,
            MarkKind::PrintSize => relation.printsize = true,
        }
    }

    // --- unknown names

    /// Reports each unknown name once, with the places of its uses.
    pub fn report_unknown(&mut self, faults: &mut Faults) {
        let unknown = std::mem::take(&mut self.unknown);
        if !self.complete {
            return;
        }
        for (index, (name, uses)) in unknown.types.iter().enumerate() {
            let fault = Diagnostic::new(Code::UnknownType, format!("no type `{name}` is declared"));
            let mut fault = with_uses(fault, uses);
            if matches!(name.as_str(), "float" | "unsigned") {
                fault = Diagnostic::new(Code::Unsupported, format!("the type `{name}` is not supported"));
                fault = with_uses(fault, uses).help("the types are `symbol`, `number` and subtypes of them");
            } else {
                let candidates = self.types.iter().map(|ty| ty.name.as_str());
                let near = if index < MAX_SUGGESTIONS {
                    did_you_mean(name, candidates)
                } else {
                    None
                };
                fault = match near {
                    Some(near) => {
                        let id = self.types.iter().position(|ty| ty.name == near);
                        if let Some(span) = id.and_then(|id| self.type_spans[id]) {
                            fault = fault.also(span, format!("`{near}` is declared here"));
                        }
                        fault.help(format!("did you mean `{near}`?"))
                    }
                    None => fault.help(format!("declare it: `.type {name} <: symbol`")),
                };
            }
            faults.push(fault);
        }
        for (index, (name, uses)) in unknown.predicates.iter().enumerate() {
            if matches!(name.as_str(), "match" | "contains") {
                let fault = Diagnostic::new(Code::Unsupported, format!("the constraint `{name}` is not supported"));
                faults.push(with_uses(fault, uses));
                continue;
            }
            let fault = Diagnostic::new(Code::UnknownPredicate, format!("no predicate `{name}` is declared"));
            let mut fault = with_uses(fault, uses);
            let candidates = self.relations.iter().map(|relation| relation.name.as_str());
            let near = if index < MAX_SUGGESTIONS {
                did_you_mean(name, candidates)
            } else {
                None
            };
            fault = match near {
                Some(near) => {
                    let span = self.relation_by_name.get(near).map(|&id| self.relation(id).span);
                    if let Some(span) = span {
                        fault = fault.also(span, format!("`{near}` is declared here"));
                    }
                    fault.help(format!("did you mean `{near}`?"))
                }
                None => fault.help(format!(
                    "declare it: `.decl {name}(...)`, or include the file that does"
                )),
            };
            faults.push(fault);
        }
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
        fault = fault.note(format!("it is used in {} more places", uses.len() - MAX_USES_SHOWN));
    }
    fault
}
