//! Declarations of types: subtypes, unions and aliases.

use crate::check::names::{Names, remember};
use crate::check::rules::{RECORDS, RecordShape, Type, TypeId};
use crate::codes;
use crate::diag::{self, Diagnostic, Faults, Span};
use crate::syntax::ast::BaseType;
use crate::syntax::ast::{ColumnDecl, Item, Name, TypeDecl, TypeDefinition};
use std::collections::{HashMap, HashSet};

/// Maximum length of a chain of subtypes.
const MAX_TYPE_DEPTH: usize = 64;

/// Maximum number of members of a union.
const MAX_MEMBERS: usize = 128;

impl Names {
    pub(super) fn declare_types(&mut self, items: &[Item], faults: &mut Faults) {
        for base in BaseType::ALL {
            self.add_type(base.name(), base, None, String::new());
        }
        // No declaration can name it.
        self.add_type(BaseType::Record.name(), BaseType::Record, None, String::new());
        self.type_by_name.remove(BaseType::Record.name());
        let mut declared: Vec<&TypeDecl> = Vec::new();
        let mut first: HashMap<&str, &TypeDecl> = HashMap::new();
        for item in items {
            let Item::Type(decl) = item else { continue };
            let name = decl.name.text.as_str();
            // The parent of an old form is not written.
            self.has_old_types |=
                matches!(&decl.definition, TypeDefinition::Subtype(parent) if parent.place == decl.name.place);
            if self.type_by_name.contains_key(name) {
                let fault = Diagnostic::new(codes::DUPLICATE_DECLARATION, format!("the type `{name}` is built in"))
                    .at(decl.name.place.0, "");
                faults.push(fault);
            } else if let Some(earlier) = first.get(name).filter(|earlier| {
                // What a lattice is about may be declared beside it.
                ![&earlier.definition, &decl.definition]
                    .iter()
                    .any(|one| matches!(one, TypeDefinition::Faulty))
            }) {
                let fault = Diagnostic::new(
                    codes::DUPLICATE_DECLARATION,
                    format!("the type `{name}` is declared twice"),
                )
                .at(decl.name.place.0, "declared again here")
                .also(earlier.name.place.0, "first declared here");
                faults.push(fault);
            } else {
                first.insert(name, decl);
                self.declared_types.insert(name.to_owned(), decl.name.place.0);
                declared.push(decl);
            }
        }
        // Every type gets its number before parents are resolved, so that declarations may come in any order.
        for decl in &declared {
            let is_new = !matches!(decl.definition, TypeDefinition::Alias(_) | TypeDefinition::Faulty);
            if is_new {
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
                TypeDefinition::Subtype(_)
                | TypeDefinition::Union(_)
                | TypeDefinition::Record(_)
                | TypeDefinition::Branches(_) => {}
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
        for decl in &declared {
            if let TypeDefinition::Union(members) = &decl.definition
                && let Some(id) = self.type_by_name[&decl.name.text]
            {
                let known: Vec<TypeId> = members.iter().filter_map(|member| self.type_named(member)).collect();
                faulty[id.0 as usize] |= known.len() < members.len();
                // Until all base types are known, the first member stands in as the parent.
                self.types[id.0 as usize].parent = known.first().copied();
                self.types[id.0 as usize].members = known;
            }
        }
        self.declare_shapes(&declared, &mut faulty, faults);
        self.refuse_subtypes_of_unions(&declared, &mut faulty, faults);
        self.settle_parents(&mut faulty, faults);
        self.settle_unions(&declared, &mut faulty, faults);
        self.spread_faults(&mut faulty);
        for decl in &declared {
            if let Some(id) = self.type_by_name[&decl.name.text]
                && faulty[id.0 as usize]
            {
                for (branch, _) in self.branches.values_mut().filter(|(ty, _)| *ty == Some(id)) {
                    *branch = None;
                }
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
            members: Vec::new(),
            shapes: Vec::new(),
            doc,
        });
        self.type_spans.push(span);
        self.type_by_name.insert(name.to_owned(), Some(id));
        id
    }

    /// Resolves the fields of record types and of the branches of algebraic data types.
    fn declare_shapes(&mut self, declared: &[&TypeDecl], faulty: &mut [bool], faults: &mut Faults) {
        for decl in declared {
            let shapes: Vec<(Option<&Name>, &[ColumnDecl])> = match &decl.definition {
                TypeDefinition::Record(fields) => vec![(None, fields)],
                TypeDefinition::Branches(branches) => (branches.iter())
                    .map(|branch| (Some(&branch.name), branch.fields.as_slice()))
                    .collect(),
                _ => continue,
            };
            let Some(id) = self.type_by_name[&decl.name.text] else {
                continue;
            };
            let mut found = Vec::new();
            for (branch, fields) in shapes {
                for (at, field) in fields.iter().enumerate() {
                    let name = &field.name;
                    if let Some(earlier) = fields[..at].iter().find(|earlier| earlier.name.text == name.text) {
                        let message = format!("two fields are called `{}`", name.text);
                        let fault = Diagnostic::new(codes::DUPLICATE_DECLARATION, message)
                            .at(name.place.0, "again here")
                            .also(earlier.name.place.0, "first here");
                        faults.push(fault.help("rename one of them"));
                    }
                }
                if let Some(branch) = branch
                    && let Some((_, earlier)) = self.branches.insert(branch.text.clone(), (Some(id), branch.place.0))
                {
                    let message = format!("two branches are called `{}`", branch.text);
                    let fault = Diagnostic::new(codes::DUPLICATE_DECLARATION, message)
                        .at(branch.place.0, "again here")
                        .also(earlier, "first here");
                    faults.push(fault.help("rename one of them: `$` and the name determine the type of a value"));
                }
                let known = |field: &ColumnDecl| Some((field.name.text.clone(), self.type_named(&field.ty)?));
                let resolved: Vec<(String, TypeId)> = fields.iter().filter_map(known).collect();
                faulty[id.0 as usize] |= resolved.len() < fields.len();
                found.push(RecordShape {
                    branch: branch.map(|branch| branch.text.clone()),
                    fields: resolved,
                });
            }
            self.types[id.0 as usize].parent = Some(RECORDS);
            self.types[id.0 as usize].shapes = found;
        }
    }

    /// Makes the types faulty whose fields, members or parents are, so that no message follows about their values.
    fn spread_faults(&self, faulty: &mut [bool]) {
        let mut users: Vec<Vec<usize>> = vec![Vec::new(); self.types.len()];
        for (id, ty) in self.types.iter().enumerate() {
            let fields = ty.shapes.iter().flat_map(|shape| &shape.fields).map(|(_, field)| field);
            for part in fields.chain(&ty.members).chain(&ty.parent) {
                users[part.0 as usize].push(id);
            }
        }
        let mut spreading: Vec<usize> = (0..faulty.len()).filter(|&id| faulty[id]).collect();
        while let Some(id) = spreading.pop() {
            for user in std::mem::take(&mut users[id]) {
                if !std::mem::replace(&mut faulty[user], true) {
                    spreading.push(user);
                }
            }
        }
    }

    /// Follows a chain of aliases to a type.
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
                    let message = format!("the type `{}` is an alias of itself", decl.name.text);
                    faults.push(Diagnostic::new(codes::CYCLIC_TYPE, message).at(decl.name.place.0, ""));
                    return None;
                }
                Some(_) if steps > MAX_TYPE_DEPTH => {
                    let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "too long a chain of types")
                        .at(decl.name.place.0, "")
                        .note(format!("a chain of aliases has at most {MAX_TYPE_DEPTH} names"));
                    faults.push(fault);
                    return None;
                }
                Some(next) => next,
                None => return self.type_named(other),
            };
        }
        None
    }

    /// Reports subtypes of unions: a subtype needs a single chain of parents.
    fn refuse_subtypes_of_unions(&self, declared: &[&TypeDecl], faulty: &mut [bool], faults: &mut Faults) {
        let is_union = |decl: &&&TypeDecl| matches!(decl.definition, TypeDefinition::Union(_));
        let unions: HashMap<TypeId, Span> = (declared.iter().filter(is_union))
            .filter_map(|decl| Some((self.type_by_name[&decl.name.text]?, decl.name.place.0)))
            .collect();
        for decl in declared {
            if let (TypeDefinition::Subtype(parent), Some(id)) = (&decl.definition, self.type_by_name[&decl.name.text])
                && let Some(union) = self.types[id.0 as usize].parent.and_then(|id| unions.get(&id))
            {
                faulty[id.0 as usize] = true;
                let message = format!("`{}` is a subtype of the union `{}`", decl.name.text, parent.text);
                let fault = Diagnostic::new(codes::TYPE_MISMATCH, message)
                    .at(parent.place.0, "")
                    .also(*union, "the union")
                    .help("make it a subtype of a member");
                faults.push(fault);
            }
        }
    }

    /// Finds the base type of every type through its parents. Types on a cycle or under a faulty type become faulty.
    fn settle_parents(&mut self, faulty: &mut [bool], faults: &mut Faults) {
        // 0: not visited; otherwise the distance from the base type, plus one.
        let mut depth = vec![0_usize; self.types.len()];
        let bases = RECORDS.0 as usize + 1;
        depth[..bases].fill(1);
        let mut reported_on = vec![usize::MAX; self.types.len()];
        for start in bases..self.types.len() {
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
                let mut fault =
                    Diagnostic::new(codes::CYCLIC_TYPE, format!("the type `{name}` is a subtype of itself"));
                for (index, &id) in cycle.iter().enumerate() {
                    let Some(span) = self.type_spans[id] else { continue };
                    fault = if index == 0 {
                        fault.at(span, "")
                    } else {
                        fault.also(span, "on the cycle")
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
                    let mut fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "too long a chain of subtypes")
                        .note(format!("a type has at most {MAX_TYPE_DEPTH} ancestors"));
                    if let Some(span) = self.type_spans[id] {
                        fault = fault.at(span, "");
                    }
                    faults.push(fault);
                }
            }
        }
        // Removing these parents protects later traversals from cycles.
        for (id, ty) in self.types.iter_mut().enumerate() {
            if faulty[id] {
                ty.parent = None;
            }
        }
    }

    /// Checks that the members of a union have one base type and do not include the union itself.
    fn settle_unions(&mut self, declared: &[&TypeDecl], faulty: &mut [bool], faults: &mut Faults) {
        for decl in declared {
            let (TypeDefinition::Union(written), Some(id)) = (&decl.definition, self.type_by_name[&decl.name.text])
            else {
                continue;
            };
            let at = id.0 as usize;
            let members = self.types[at].members.clone();
            faulty[at] |= members.iter().any(|member| faulty[member.0 as usize]);
            if faulty[at] {
                self.types[at].members.clear();
                self.types[at].parent = None;
                continue;
            }
            // Expand the members that are unions, to find cycles.
            let mut seen = HashSet::new();
            let mut work = members.clone();
            let mut leaves = Vec::new();
            while let Some(member) = work.pop() {
                if seen.len() <= MAX_MEMBERS && seen.insert(member) {
                    let parts = &self.types[member.0 as usize].members;
                    work.extend(parts);
                    leaves.extend(parts.is_empty().then_some(member));
                }
            }
            leaves.sort_unstable();
            let name = &decl.name.text;
            let base = self.base(id);
            let other = members.iter().position(|&member| self.base(member) != base);
            if seen.len() > MAX_MEMBERS {
                let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, "union of too many types")
                    .at(decl.name.place.0, "")
                    .note(format!(
                        "a union has at most {MAX_MEMBERS} members, including those of its members"
                    ));
                faults.push(fault);
            } else if seen.contains(&id) {
                let message = format!("the type `{name}` contains itself");
                faults.push(Diagnostic::new(codes::CYCLIC_TYPE, message).at(decl.name.place.0, ""));
            } else if let Some(other) = other {
                let message = format!(
                    "the union `{name}` has values of type `{}` and of type `{}`",
                    base.name(),
                    self.base(members[other]).name()
                );
                let fault = Diagnostic::new(codes::TYPE_MISMATCH, message).at(written[other].place.0, "");
                faults.push(fault.also(written[0].place.0, format!("`{}` here", base.name())));
            } else {
                self.types[at].parent = Some(Self::base_type(base));
                self.types[at].members = leaves;
                continue;
            }
            faulty[at] = true;
            self.types[at].members.clear();
            self.types[at].parent = None;
        }
    }

    /// Returns the type with that name. Records an unknown name for [`Names::report_unknown`].
    pub fn type_named(&mut self, name: &Name) -> Option<TypeId> {
        match self.type_by_name.get(&name.text) {
            Some(known) => *known,
            None => {
                remember(&mut self.unknown.types, name);
                None
            }
        }
    }
}
