//! Instances of components as plain declarations and clauses.
//!
//! ```text
//! .comp Graph<T> { .decl edge(x: T, y: T) ... }    .init g = Graph<number>    becomes    .decl g.edge(x: number, y: number) ...
//! ```
//!
//! A name in a component means what the instance declares, else what the instance or the program around it declares.
//! The copies of an instance lie in sources of their own ([`Sources::add_instance`]), so that messages name the place in
//! the component and the `.init`.
// Decision: docs/decisions/language.md#d081

use std::collections::{BTreeMap, HashMap, HashSet};
use std::rc::Rc;

use crate::codes;
use crate::diag::{self, Diagnostic, Faults, SourceId, Sources, Span, did_you_mean};
use crate::syntax::ast::{
    Atom, Clause, ColumnDecl, Component, ComponentType, Decl, Init, Item, Literal, Name, Place, Scope, Term, TermKind,
    TypeDecl, TypeDefinition,
};
use crate::syntax::functor::Functor;

/// Maximum depth of instances in instances, and of bases of bases.
const MAX_DEPTH: usize = 64;

/// Maximum number of instances of a program.
const MAX_INSTANCES: usize = 10_000;

/// Maximum number of bases of a component, those of bases included.
const MAX_LAYERS: usize = 1_000;

/// Maximum number of directives and clauses that the instances of a program have.
const MAX_ITEMS: usize = 1_000_000;

/// The instances of a program, which grows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Instances {
    /// The number of `.init` of the program that are done.
    done: usize,
    items: usize,
    /// Whether an instance is missing, so that names may be declared that are not.
    pub incomplete: bool,
}

impl Instances {
    /// Returns the items of the instances that `items` make and that earlier calls have not returned. The components
    /// are those of all items.
    pub(crate) fn next(&mut self, items: &[Item], sources: &mut Sources, faults: &mut Faults) -> Vec<Item> {
        let inits = items.iter().filter_map(|item| match item {
            Item::Init(init) => Some(init),
            _ => None,
        });
        let inits: Vec<&Init> = inits.collect();
        let new = &inits[self.done.min(inits.len())..];
        self.done = inits.len();
        let mut maker = Maker {
            definitions: Vec::new(),
            top: HashMap::new(),
            made: Vec::new(),
            reported: HashSet::new(),
            stopped: false,
            sources,
            faults,
        };
        let top = maker.define(items, None);
        maker.top = top;
        if new.is_empty() {
            return Vec::new();
        }
        let global = Rc::new(Binding::default());
        let mut names: HashMap<&str, Span> = HashMap::new();
        for init in &inits[..inits.len() - new.len()] {
            names.insert(&init.name.text, init.name.place.0);
        }
        for init in new {
            if let Some(&earlier) = names.get(init.name.text.as_str()) {
                maker.duplicate("instance", &init.name, earlier);
                continue;
            }
            names.insert(&init.name.text, init.name.place.0);
            maker.make(init, None, None, &global, 0);
        }
        let mut found = Vec::new();
        for at in 0..maker.made.len() {
            maker.emit(at, &mut found);
            if self.items + found.len() > MAX_ITEMS {
                let span = maker.made[at].span;
                maker.too_many("the instances of components have too many clauses", MAX_ITEMS, span);
                break;
            }
        }
        self.items += found.len();
        self.incomplete |= !maker.reported.is_empty() || maker.stopped;
        // A scope of the program does not extend to its instances.
        let scope = items.iter().rev().find_map(|item| match item {
            Item::Scope(scope) => Some(scope),
            _ => None,
        });
        if let Some(scope) = scope.filter(|scope| scope.predicate.is_some() && !found.is_empty()) {
            let end = Scope {
                predicate: None,
                place: scope.place,
            };
            found.insert(0, Item::Scope(end));
        }
        found
    }
}

/// A component with its place among the others.
struct Definition<'i> {
    component: &'i Component,
    /// The component whose text contains it.
    parent: Option<usize>,
    nested: HashMap<&'i str, usize>,
}

/// The types, and components, for which the parameters of a component stand.
#[derive(Default)]
struct Binding<'i> {
    arguments: HashMap<&'i str, Argument<'i>>,
    /// The binding of the component whose text contains this one.
    around: Option<Rc<Binding<'i>>>,
}

impl<'i> Binding<'i> {
    /// Returns what a name stands for, if it is that of a parameter.
    fn get(&self, name: &str) -> Option<&Argument<'i>> {
        let mut bindings = std::iter::successors(Some(self), |binding| binding.around.as_deref());
        bindings.find_map(|binding| binding.arguments.get(name))
    }
}

struct Argument<'i> {
    /// The name as the program writes it outside of all components.
    component: String,
    /// The name as it is written, and where that is.
    written: &'i str,
    instance: Option<usize>,
    binding: Rc<Binding<'i>>,
}

/// A component as a part of an instance: the component itself or one of its bases.
struct Layer<'i> {
    definition: usize,
    binding: Rc<Binding<'i>>,
    /// The predicates that components derived from it define anew.
    overridden: Rc<HashSet<&'i str>>,
    /// Whether a parameter stands for it or for a component derived from it, so that what it declares depends on the
    /// instance.
    by_parameter: bool,
}

struct Instance<'i> {
    /// The names of the instances around it and its own, between dots.
    path: String,
    parent: Option<usize>,
    layers: Vec<Layer<'i>>,
    /// The bindings of the component and of its bases. Lookup only, never iterated.
    bindings: HashMap<usize, Rc<Binding<'i>>>,
    predicates: HashSet<&'i str>,
    types: HashSet<&'i str>,
    branches: HashSet<&'i str>,
    children: HashMap<&'i str, usize>,
    /// The place of the `.init`.
    span: Span,
    label: String,
    /// The copies of sources for this instance.
    copies: BTreeMap<SourceId, SourceId>,
}

struct Maker<'i, 's> {
    definitions: Vec<Definition<'i>>,
    top: HashMap<&'i str, usize>,
    made: Vec<Instance<'i>>,
    /// The places of faults, each of which many instances may have.
    reported: HashSet<Span>,
    /// Whether a limit was reached.
    stopped: bool,
    sources: &'s mut Sources,
    faults: &'s mut Faults,
}

impl<'i> Maker<'i, '_> {
    /// Reports a fault, once for each place.
    fn fault(&mut self, at: Span, fault: impl FnOnce() -> Diagnostic) {
        if self.reported.insert(at) {
            self.faults.push(fault());
        }
    }

    fn duplicate(&mut self, what: &str, name: &Name, earlier: Span) {
        let text = &name.text;
        self.fault(name.place.0, || {
            Diagnostic::new(
                codes::DUPLICATE_DECLARATION,
                format!("the {what} `{text}` is declared twice"),
            )
            .at(name.place.0, "")
            .also(earlier, "declared here first")
        });
    }

    fn too_many(&mut self, message: &str, limit: usize, at: Span) {
        if !std::mem::replace(&mut self.stopped, true) {
            let fault = Diagnostic::new(diag::codes::LIMIT_EXCEEDED, message).at(at, "");
            self.faults.push(fault.note(format!("there are at most {limit}")));
        }
    }

    /// Adds the components among items, with those in them. Returns them by name.
    fn define(&mut self, items: &'i [Item], parent: Option<usize>) -> HashMap<&'i str, usize> {
        let mut names: HashMap<&str, usize> = HashMap::new();
        for item in items {
            let Item::Component(component) = item else { continue };
            let at = self.definitions.len();
            self.definitions.push(Definition {
                component,
                parent,
                nested: HashMap::new(),
            });
            let nested = self.define(&component.items, Some(at));
            self.definitions[at].nested = nested;
            match names.get(component.name.text.as_str()) {
                Some(&earlier) => {
                    let earlier = self.definitions[earlier].component.name.place.0;
                    self.duplicate("component", &component.name, earlier);
                }
                None => _ = names.insert(&component.name.text, at),
            }
        }
        names
    }

    /// Returns the component of this name, as the text of the component `scope` sees it: one in it or in a base of it,
    /// else in those around it.
    fn find(&self, name: &str, mut scope: Option<usize>) -> Option<usize> {
        while let Some(at) = scope {
            if let Some(found) = self.inherited(name, at) {
                return Some(found);
            }
            scope = self.definitions[at].parent;
        }
        self.top.get(name).copied()
    }

    /// Returns the component of this name in a component or in one of its bases that no parameter stands for.
    fn inherited(&self, name: &str, of: usize) -> Option<usize> {
        let mut seen = HashSet::new();
        let mut open = vec![of];
        while let Some(at) = open.pop() {
            let Definition {
                component,
                parent,
                nested,
            } = &self.definitions[at];
            if let Some(&found) = nested.get(name) {
                return Some(found);
            }
            if seen.insert(at) {
                let bases = component.bases.iter().rev().map(|base| base.name.text.as_str());
                let named = bases.filter(|base| !self.is_parameter(base, at));
                open.extend(named.filter_map(|base| self.around(base, *parent)));
            }
        }
        None
    }

    /// Returns whether a name is a parameter of a component or of those around it.
    fn is_parameter(&self, name: &str, of: usize) -> bool {
        let mut scope = Some(of);
        while let Some(at) = scope {
            let Definition { component, parent, .. } = &self.definitions[at];
            if component.parameters.iter().any(|parameter| parameter.text == name) {
                return true;
            }
            scope = *parent;
        }
        false
    }

    /// Returns the component of this name in a component or in those around it.
    fn around(&self, name: &str, mut scope: Option<usize>) -> Option<usize> {
        while let Some(at) = scope {
            if let Some(&found) = self.definitions[at].nested.get(name) {
                return Some(found);
            }
            scope = self.definitions[at].parent;
        }
        self.top.get(name).copied()
    }

    /// Finds the component that a type names, or reports that there is none.
    fn component(&mut self, of: &'i ComponentType, scope: Option<usize>, binding: &Binding<'i>) -> Option<usize> {
        let name = &of.name;
        let bound = binding.get(name.text.as_str());
        let wanted = bound
            .map_or(name.text.as_str(), |argument| argument.component.as_str())
            .to_owned();
        let found = self.find(&wanted, scope);
        if found.is_none() {
            let near = did_you_mean(
                &wanted,
                self.definitions.iter().map(|known| known.component.name.text.as_str()),
            );
            let near = near.map(str::to_owned);
            self.fault(name.place.0, || {
                let fault = Diagnostic::new(codes::UNKNOWN_COMPONENT, format!("no component `{wanted}` is declared"));
                let fault = fault.at(name.place.0, "");
                match near {
                    Some(near) => fault.did_you_mean(&near, &[name.place.0]),
                    None => fault,
                }
            });
        }
        found
    }

    /// Binds the parameters of a component.
    fn bind(
        &mut self,
        definition: usize,
        of: &'i ComponentType,
        instance: Option<usize>,
        binding: &Rc<Binding<'i>>,
    ) -> Option<Rc<Binding<'i>>> {
        let component = self.definitions[definition].component;
        let (wanted, given) = (component.parameters.len(), of.arguments.len());
        if wanted != given {
            self.fault(of.name.place.0, || {
                let message = format!(
                    "the component `{}` takes {}, not {given}",
                    component.name.text,
                    diag::counted(wanted, "argument")
                );
                Diagnostic::new(codes::INVALID_COMPONENT, message)
                    .at(of.name.place.0, "")
                    .also(component.name.place.0, "declared here")
            });
            return None;
        }
        let arguments = component
            .parameters
            .iter()
            .zip(&of.arguments)
            .map(|(parameter, argument)| {
                let written = argument.text.as_str();
                let bound = binding.get(written);
                let argument = Argument {
                    component: bound.map_or(written, |argument| &argument.component).to_owned(),
                    written,
                    instance,
                    binding: binding.clone(),
                };
                (parameter.text.as_str(), argument)
            });
        // In a component within another one, the parameters of that have their meaning, too.
        let around = self.definitions[definition].parent.and_then(|parent| {
            let mut instances = std::iter::successors(instance, |&at| self.made[at].parent);
            instances.find_map(|at| self.made[at].bindings.get(&parent))
        });
        Some(Rc::new(Binding {
            arguments: arguments.collect(),
            around: around.cloned(),
        }))
    }

    /// Makes an instance and those in it. `scope` is the component whose text contains the `.init`.
    fn make(
        &mut self,
        init: &'i Init,
        scope: Option<usize>,
        parent: Option<usize>,
        binding: &Rc<Binding<'i>>,
        depth: usize,
    ) -> Option<usize> {
        let place = init.place.0;
        if self.stopped {
            return None;
        }
        if depth >= MAX_DEPTH {
            self.stopped = true;
            let name = init.component.name.text.as_str();
            let fault = Diagnostic::new(
                codes::INVALID_COMPONENT,
                format!("the component `{name}` has no finite instance"),
            );
            let fault = fault.at(place, "this makes one more instance within each instance");
            self.faults
                .push(fault.note(format!("instances contain others at most {MAX_DEPTH} deep")));
            return None;
        }
        if self.made.len() >= MAX_INSTANCES {
            self.too_many("too many instances of components", MAX_INSTANCES, place);
            return None;
        }
        let definition = self.component(&init.component, scope, binding)?;
        let inner = self.bind(definition, &init.component, parent, binding)?;
        let component = self.definitions[definition].component;
        let path = match parent {
            Some(parent) => format!("{}.{}", self.made[parent].path, init.name.text),
            None => init.name.text.clone(),
        };
        let at = self.made.len();
        self.made.push(Instance {
            label: format!("in the instance `{path}` of `{}`, made here", component.name.text),
            path,
            parent,
            layers: Vec::new(),
            bindings: HashMap::new(),
            predicates: HashSet::new(),
            types: HashSet::new(),
            branches: HashSet::new(),
            children: HashMap::new(),
            span: place,
            copies: BTreeMap::new(),
        });
        let mut layers = Vec::new();
        let own = Layer {
            definition,
            binding: inner,
            overridden: Rc::new(HashSet::new()),
            by_parameter: false,
        };
        self.layers(own, at, &mut vec![definition], &mut layers);
        for layer in &layers {
            self.made[at].bindings.insert(layer.definition, layer.binding.clone());
            for item in &self.definitions[layer.definition].component.items {
                match item {
                    Item::Decl(decl) => {
                        let names = decl.names.iter().map(|name| name.text.as_str());
                        self.made[at].predicates.extend(names);
                    }
                    Item::Type(decl) => {
                        self.made[at].types.insert(&decl.name.text);
                        // Each instance has its own branches.
                        if let TypeDefinition::Branches(branches) = &decl.definition {
                            let names = branches.iter().map(|branch| branch.name.text.as_str());
                            self.made[at].branches.extend(names);
                        }
                    }
                    _ => {}
                }
            }
        }
        let mut names: HashMap<&str, Span> = HashMap::new();
        for layer in &layers {
            for item in &self.definitions[layer.definition].component.items {
                let Item::Init(init) = item else { continue };
                if let Some(&earlier) = names.get(init.name.text.as_str()) {
                    self.duplicate("instance", &init.name, earlier);
                    continue;
                }
                names.insert(&init.name.text, init.name.place.0);
                if let Some(child) = self.make(init, Some(layer.definition), Some(at), &layer.binding, depth + 1) {
                    self.made[at].children.insert(&init.name.text, child);
                }
            }
        }
        self.made[at].layers = layers;
        Some(at)
    }

    /// Adds a component and its bases to the parts of an instance, the bases first. `chain` leads from the component of
    /// the instance to this one.
    fn layers(&mut self, own: Layer<'i>, instance: usize, chain: &mut Vec<usize>, layers: &mut Vec<Layer<'i>>) {
        let Definition { component, parent, .. } = self.definitions[own.definition];
        let mut overridden = (*own.overridden).clone();
        let names = component.items.iter().filter_map(|item| match item {
            Item::Override(names) => Some(&names.names),
            _ => None,
        });
        let names: Vec<&Name> = names.flatten().collect();
        overridden.extend(names.iter().map(|name| name.text.as_str()));
        let overridden = Rc::new(overridden);
        let first = layers.len();
        for base in &component.bases {
            let Some(definition) = self.component(base, parent, &own.binding) else {
                continue;
            };
            if layers.len() >= MAX_LAYERS || chain.len() > MAX_DEPTH && !chain.contains(&definition) {
                self.too_many("too many bases of a component", MAX_LAYERS, base.name.place.0);
                return;
            }
            if chain.contains(&definition) {
                self.fault(base.name.place.0, || {
                    let message = format!("the component `{}` is its own base", component.name.text);
                    Diagnostic::new(codes::INVALID_COMPONENT, message).at(base.name.place.0, "")
                });
                continue;
            }
            let Some(binding) = self.bind(definition, base, Some(instance), &own.binding) else {
                continue;
            };
            let layer = Layer {
                definition,
                binding,
                overridden: overridden.clone(),
                by_parameter: own.by_parameter || own.binding.get(&base.name.text).is_some(),
            };
            chain.push(definition);
            self.layers(layer, instance, chain, layers);
            chain.pop();
        }
        for name in names {
            self.check_override(name, &layers[first..]);
        }
        layers.push(own);
    }

    /// Reports an `.override` of a predicate that no base declares, or that is not overridable.
    fn check_override(&mut self, name: &'i Name, bases: &[Layer<'i>]) {
        let items = bases.iter().flat_map(|base| {
            let items = self.definitions[base.definition].component.items.iter();
            items.map(|item| (item, base.by_parameter))
        });
        let declared = items.filter_map(|(item, by_parameter)| match item {
            Item::Decl(decl) if decl.names.iter().any(|known| known.text == name.text) => Some((decl, by_parameter)),
            _ => None,
        });
        let declared: Vec<(&Decl, bool)> = declared.collect();
        // Which predicates a parameter provides, and how, is not known where the component is written.
        let fixed = declared.iter().find(|(decl, by_parameter)| {
            !by_parameter && !decl.qualifiers.iter().any(|word| word.text == "overridable")
        });
        let (text, place) = (&name.text, name.place.0);
        if let Some((decl, _)) = fixed {
            let known = decl
                .names
                .iter()
                .find(|known| known.text == name.text)
                .unwrap_or(name)
                .place
                .0;
            self.fault(place, || {
                Diagnostic::new(codes::INVALID_COMPONENT, format!("`{text}` cannot be overridden"))
                    .at(place, "")
                    .also(known, "declared here")
                    .help("write `overridable` after the columns of its declaration")
            });
        } else if declared.is_empty() && self.reported.insert(place) {
            let fault = Diagnostic::new(codes::IGNORED, format!("`.override {text}` has no effect"));
            self.faults
                .push(fault.at(place, "no base of the component declares it"));
            self.reported.remove(&place);
        }
    }

    /// Returns the name that a predicate has outside of all instances.
    fn predicate(&self, from: usize, name: &str) -> String {
        self.global(from, name, |instance| &instance.predicates)
    }

    /// Returns the name that a type has outside of all instances.
    fn type_name(&self, from: Option<usize>, name: &str, binding: &Binding<'i>) -> String {
        if let Some(argument) = binding.get(name) {
            return self.type_name(argument.instance, argument.written, &argument.binding);
        }
        match from {
            Some(from) => self.global(from, name, |instance| &instance.types),
            None => name.to_owned(),
        }
    }

    fn global(
        &self,
        from: usize,
        name: &str,
        declared: for<'a> fn(&'a Instance<'i>) -> &'a HashSet<&'i str>,
    ) -> String {
        let mut around = Some(from);
        while let Some(at) = around {
            let instance = &self.made[at];
            let known = match name.split_once('.') {
                None => declared(instance).contains(name),
                Some((first, _)) => instance.children.contains_key(first),
            };
            if known {
                return format!("{}.{name}", instance.path);
            }
            around = instance.parent;
        }
        name.to_owned()
    }

    /// Returns the copy of a source for an instance.
    fn copy_of(&mut self, instance: usize, source: SourceId) -> SourceId {
        if let Some(&copy) = self.made[instance].copies.get(&source) {
            return copy;
        }
        let of = match self.made[instance].parent {
            Some(parent) => self.copy_of(parent, source),
            None => source,
        };
        let Instance { span, label, .. } = &self.made[instance];
        let copy = self.sources.add_instance(of, *span, label.clone());
        self.made[instance].copies.insert(source, copy);
        copy
    }

    /// Appends the items of an instance, without those of instances in it.
    fn emit(&mut self, at: usize, found: &mut Vec<Item>) {
        let layers = std::mem::take(&mut self.made[at].layers);
        for Layer {
            definition,
            binding,
            overridden,
            ..
        } in &layers
        {
            let component = self.definitions[*definition].component;
            let mut rename = Rename {
                maker: &mut *self,
                instance: at,
                binding,
            };
            // Whether the clause before a `.plan` is there.
            let mut kept = true;
            for item in &component.items {
                let is_fixed = |head: &str| !overridden.contains(head.split('.').next().unwrap_or(head));
                let mut item = match item {
                    Item::Component(_) | Item::Init(_) | Item::Override(_) | Item::Include(_) => continue,
                    Item::Plan(_) if !kept => continue,
                    Item::Subsumption(subsumption) if !is_fixed(&subsumption.weaker.predicate.text) => {
                        kept = false;
                        continue;
                    }
                    Item::Clause(clause) => {
                        let mut clause = clause.clone();
                        if clause.probabilities.is_empty() {
                            clause.heads.retain(|head| is_fixed(&head.predicate.text));
                        } else if !clause.heads.iter().all(|head| is_fixed(&head.predicate.text)) {
                            clause.heads.clear();
                        }
                        kept = !clause.heads.is_empty();
                        if !kept {
                            continue;
                        }
                        Item::Clause(clause)
                    }
                    other => other.clone(),
                };
                rename.item(&mut item);
                found.push(item);
            }
        }
        self.made[at].layers = layers;
    }
}

/// Gives the names in items of a component the names that they have outside of an instance, and moves their places to
/// the copies of their sources.
struct Rename<'m, 'i, 's> {
    maker: &'m mut Maker<'i, 's>,
    instance: usize,
    binding: &'m Binding<'i>,
}

impl Rename<'_, '_, '_> {
    fn place(&mut self, place: &mut Place) {
        place.0.source = self.maker.copy_of(self.instance, place.0.source);
    }

    /// A name that the instance declares.
    fn declared(&mut self, name: &mut Name) {
        name.text = format!("{}.{}", self.maker.made[self.instance].path, name.text);
        self.place(&mut name.place);
    }

    fn predicate(&mut self, name: &mut Name) {
        name.text = self.maker.predicate(self.instance, &name.text);
        self.place(&mut name.place);
    }

    fn type_name(&mut self, name: &mut Name) {
        name.text = self.maker.type_name(Some(self.instance), &name.text, self.binding);
        self.place(&mut name.place);
    }

    fn item(&mut self, item: &mut Item) {
        match item {
            Item::Type(TypeDecl { name, definition, .. }) => {
                // A declaration of a parameter declares the type that it stands for.
                match self.binding.get(&name.text).is_some() {
                    true => self.type_name(name),
                    false => self.declared(name),
                }
                match definition {
                    TypeDefinition::Subtype(of) | TypeDefinition::Alias(of) => self.type_name(of),
                    TypeDefinition::Union(members) => members.iter_mut().for_each(|member| self.type_name(member)),
                    TypeDefinition::Record(fields) => self.fields(fields),
                    TypeDefinition::Branches(branches) => {
                        for branch in branches {
                            self.declared(&mut branch.name);
                            self.fields(&mut branch.fields);
                        }
                    }
                    TypeDefinition::Faulty => {}
                }
            }
            Item::Decl(decl) => {
                decl.names.iter_mut().for_each(|name| self.declared(name));
                for column in decl.columns.iter_mut().flatten() {
                    self.place(&mut column.name.place);
                    self.type_name(&mut column.ty);
                }
                // It concerns components, which are no more.
                decl.qualifiers.retain(|word| word.text != "overridable");
                decl.qualifiers.iter_mut().for_each(|word| self.place(&mut word.place));
                let columns = decl.choices.iter_mut().flatten();
                columns.for_each(|column| self.place(&mut column.place));
            }
            Item::Mark(mark) => {
                mark.names.iter_mut().for_each(|name| self.predicate(name));
                for option in &mut mark.options {
                    self.place(&mut option.key.place);
                    self.place(&mut option.place);
                }
            }
            Item::Constraint(constraint) => {
                constraint.names.iter_mut().for_each(|name| self.predicate(name));
                self.place(&mut constraint.place);
            }
            Item::Pragma(pragma) => self.place(&mut pragma.place),
            Item::Plan(plan) => self.place(&mut plan.place),
            Item::Scope(scope) => {
                scope.predicate.iter_mut().for_each(|name| self.predicate(name));
                self.place(&mut scope.place);
            }
            Item::Subsumption(subsumption) => {
                self.atom(&mut subsumption.weaker);
                self.atom(&mut subsumption.stronger);
                subsumption.body.iter_mut().for_each(|literal| self.literal(literal));
                self.place(&mut subsumption.place);
            }
            Item::Functor(decl) => {
                self.place(&mut decl.name.place);
                for (name, ty) in &mut decl.arguments {
                    name.iter_mut().for_each(|name| self.place(&mut name.place));
                    self.type_name(ty);
                }
                self.type_name(&mut decl.result);
            }
            Item::Clause(clause) => self.clause(clause),
            Item::Include(_) | Item::Component(_) | Item::Init(_) | Item::Override(_) => {}
        }
    }

    fn fields(&mut self, fields: &mut [ColumnDecl]) {
        for field in fields {
            self.place(&mut field.name.place);
            self.type_name(&mut field.ty);
        }
    }

    fn clause(&mut self, clause: &mut Clause) {
        clause.heads.iter_mut().for_each(|head| self.atom(head));
        clause.probabilities.iter_mut().for_each(|term| self.term(term));
        clause.body.iter_mut().for_each(|literal| self.literal(literal));
        self.place(&mut clause.place);
    }

    fn atom(&mut self, atom: &mut Atom) {
        self.predicate(&mut atom.predicate);
        atom.terms.iter_mut().for_each(|term| self.term(term));
        self.place(&mut atom.place);
    }

    fn literal(&mut self, literal: &mut Literal) {
        match literal {
            Literal::Atom { atom, .. } => self.atom(atom),
            Literal::Compare { left, right, place, .. } => {
                self.term(left);
                self.term(right);
                self.place(place);
            }
            Literal::Temporal { temporal, .. } => {
                temporal.atoms_mut().for_each(|atom| self.atom(atom));
                self.place(&mut temporal.place);
            }
            Literal::Any(alternatives) => alternatives.iter_mut().flatten().for_each(|one| self.literal(one)),
        }
    }

    fn term(&mut self, term: &mut Term) {
        self.place(&mut term.place);
        match &mut term.kind {
            TermKind::Functor(functor, arguments) => {
                if let (Functor::Pack, Some(TermKind::Symbol(branch))) =
                    (functor, arguments.first_mut().map(|branch| &mut branch.kind))
                    && !branch.is_empty()
                {
                    *branch = self.maker.global(self.instance, branch, |instance| &instance.branches);
                }
                arguments.iter_mut().for_each(|argument| self.term(argument));
            }
            TermKind::Cast(inner, ty) => {
                self.term(inner);
                self.type_name(ty);
            }
            TermKind::Aggregate(aggregate) => {
                aggregate.target.iter_mut().for_each(|target| self.term(target));
                aggregate.body.iter_mut().for_each(|literal| self.literal(literal));
            }
            TermKind::Variable(_)
            | TermKind::Wildcard
            | TermKind::Number(_)
            | TermKind::Address(_)
            | TermKind::Unsigned(_)
            | TermKind::Float(_)
            | TermKind::Symbol(_) => {}
        }
    }
}
