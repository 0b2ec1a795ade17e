//! Components: their instances derive what the clauses written out derive.

use crate::preprocessor;
use logicity_datalog::diag::{Sources, render};
use logicity_datalog::files::ReadError;
use logicity_datalog::{
    InputPolicy, Loaded, PredicateId, Preprocessing, Program, Workspace, facts, format, parse, print,
};
use std::collections::BTreeMap;
use std::path::Path;

/// Loads the text of a program.
pub fn load(text: &str) -> (Sources, Loaded) {
    preprocessor::load(&[("a.dl", text)], &Preprocessing::default())
}

/// Asserts that a program has a fault with this code whose message contains a text.
pub fn has_fault(text: &str, code: &str, message: &str) {
    let (_, loaded) = load(text);
    let faults: Vec<_> = (loaded.diagnostics.iter())
        .map(|fault| (fault.code.name(), fault.message.as_str()))
        .collect();
    let fits = |(found, said): &(&str, &str)| *found == code && said.contains(message);
    assert!(faults.iter().any(fits), "{text}: {faults:#?}");
}

/// Returns the rows of each output as text, by the name of the predicate with `_` in place of dots.
fn outputs(text: &str) -> BTreeMap<String, String> {
    let (sources, loaded) = load(text);
    let shown = || format!("{text}\n{}", render(&loaded.diagnostics, &sources, false));
    let rules = loaded.rules.clone().unwrap_or_else(|| panic!("{}", shown()));
    let mut session = Program::new(rules).expect("small").session();
    session.commit().expect("small");
    let predicates = session.program().rules().predicates.clone();
    let outputs = (0..).map(PredicateId).zip(&predicates);
    outputs
        .filter(|(_, predicate)| predicate.output)
        .map(|(id, predicate)| {
            (
                predicate.name.replace('.', "_"),
                facts::print(&session, id).replace('.', "_"),
            )
        })
        .collect()
}

/// Returns the code, the place and the message of each diagnostic.
fn messages(text: &str) -> Vec<(&'static str, String, String)> {
    let (sources, loaded) = load(text);
    let traced = loaded.diagnostics.iter().map(|fault| sources.traced(fault));
    traced
        .map(|fault| {
            let place = fault.primary.as_ref().map(|label| sources.locate(label.span));
            (fault.code.name(), place.unwrap_or_default(), fault.message)
        })
        .collect()
}

/// Programs with components, and the same without.
const PAIRS: &[(&str, &str)] = &[
    // Two instances, defined after their use.
    (
        ".init a = Graph<number>\n.init b = Graph<symbol>\na.edge(1, 2). a.edge(2, 3). b.edge(\"x\", \"y\").\n\
         .comp Graph<T> {\n  .decl edge(x: T, y: T)\n  .decl path(x: T, y: T)\n  .output path\n  path(x, y) :- edge(x, y).\n  \
         path(x, z) :- path(x, y), edge(y, z).\n}\n",
        ".decl a_edge, a_path(x: number, y: number)\n.decl b_edge, b_path(x: symbol, y: symbol)\n.output a_path, b_path\n\
         a_edge(1, 2). a_edge(2, 3). b_edge(\"x\", \"y\").\na_path(x, y) :- a_edge(x, y).\n\
         a_path(x, z) :- a_path(x, y), a_edge(y, z).\nb_path(x, y) :- b_edge(x, y).\n\
         b_path(x, z) :- b_path(x, y), b_edge(y, z).\n",
    ),
    // Bases with arguments; what overrides a predicate replaces all its clauses, with their plans, in all bases.
    (
        ".comp A<T> { .decl p(x: T) overridable p(x) :- q(x), r(x). .plan 0:(2,1)\n .decl q(x: T) .decl r(x: T) }\n\
         .comp B<U> : A<U> { .override p\n p(x) :- q(x). }\n.comp C : B<number> { q(1). r(2). .output p }\n\
         .comp D : A<number> { q(1). r(1). r(2). .output p }\n.init c = C\n.init d = D\n",
        ".decl c_p, c_q, c_r, d_p, d_q, d_r(x: number)\n.output c_p, d_p\nc_q(1). c_r(2). c_p(x) :- c_q(x).\n\
         d_q(1). d_r(1). d_r(2). d_p(x) :- d_q(x), d_r(x).\n",
    ),
    // Components of a base; parameters of the component around one, which a parameter of its own hides.
    (
        ".comp M<T> {\n .decl p(x: T) .output p\n .comp In { .decl q(x: T) .output q\n q(x) :- p(x). }\n\
         .comp Own<T> { .decl r(x: T) .output r\n r(\"a\"). }\n}\n\
         .comp N : M<number> { p(1). .init i = In\n .init o = Own<symbol> }\n.comp L : N { .init j = In }\n.init n = N\n.init l = L\n",
        ".decl n_p, n_i_q, l_p, l_i_q, l_j_q(x: number)\n.decl n_o_r, l_o_r(x: symbol)\n\
         .output n_p, n_i_q, l_p, l_i_q, l_j_q, n_o_r, l_o_r\nn_p(1). l_p(1). n_o_r(\"a\"). l_o_r(\"a\").\n\
         n_i_q(x) :- n_p(x). l_i_q(x) :- l_p(x). l_j_q(x) :- l_p(x).\n",
    ),
    // The components of a base that is a parameter do not count, also where a component has the name of the parameter.
    (
        ".comp T { .comp In { .decl p(x: number) .output p\n p(1). } }\n.comp In { .decl p(x: number) .output p\n p(2). }\n\
         .comp U { .decl q(x: number) q(3). }\n.comp A<T> : T { .init x = In }\n.init a = A<U>\n",
        ".decl a_x_p(x: number)\n.output a_x_p\na_x_p(2).\n",
    ),
    // A component may override what a parameter of it declares, and may declare a type that a parameter names.
    (
        ".comp M { .decl p(x: symbol) .output p\n p(\"m\"). }\n.comp X<T, U> : T { .override p\n p(\"x\"). .type U <: number\n .decl q(x: U) .output q\n q(1). }\n\
         .init y = X<M, V>\n.decl r(x: V)\n.output r\nr(x) :- y.q(x).\n",
        ".type V <: number\n.decl y_p(x: symbol)\n.decl y_q, r(x: V)\n.output y_p, y_q, r\ny_p(\"x\"). y_q(1). r(x) :- y_q(x).\n",
    ),
    // An inline predicate about records, by those of the components for their fields.
    (
        ".comp Number { .type T = number\n .decl same(a: T, b: T, r: T) inline\n same(a, b, a) :- a = b. }\n\
         .comp Pair<D> { .init d = D\n .type T = [a: d.T, b: d.T]\n .decl same(a: T, b: T, r: T) inline\n \
         same([a, b], [c, d], [e, f]) :- d.same(a, c, e), d.same(b, d, f). }\n.comp Pairs : Pair<Number> {}\n\
         .comp Same<C> : C { .decl in(a: T, b: T)\n .decl out(r: T) .output out\n out(r) :- in(a, b), same(a, b, r). }\n\
         .init s = Same<Pairs>\ns.in([1, 2], [1, 2]). s.in([1, 2], [2, 1]).\n",
        ".type P = [a: number, b: number]\n.decl s_out(r: P)\n.output s_out\ns_out([1, 2]).\n",
    ),
    // Several bases, and clauses of a component for predicates of its bases.
    (
        ".comp A { .decl p(x: number) p(1). }\n.comp B { .decl q(x: number) q(2). }\n\
         .comp C : A, B { .decl r(x: number) .output r\n r(x) :- p(x); q(x). p(3). }\n.init c = C\n",
        ".decl c_p, c_q, c_r(x: number)\n.output c_r\nc_p(1). c_p(3). c_q(2). c_r(x) :- c_p(x); c_q(x).\n",
    ),
    // Names mean the nearest declaration: of the instance, of the instance around it, of the program.
    (
        ".decl p, q, r, out(x: number)\n.output out\np(1). q(1). r(1).\n.comp A { .decl p, q(x: number) p(2). q(2). .init b = B\n\
         .comp B { .decl p(x: number) p(3). out(10 * x) :- p(x). out(100 * x) :- q(x). out(1000 * x) :- r(x). }\n\
         out(x) :- b.p(x). out(-x) :- p(x). }\n.init a = A\nout(7 * x) :- a.b.p(x).\n",
        ".decl out(x: number)\n.output out\nout(30). out(200). out(1000). out(3). out(-2). out(21).\n",
    ),
    // Types of instances, also as arguments and outside.
    (
        ".comp A { .type T <: symbol\n .type U = T | V\n .type V <: symbol\n .decl p(x: T) p(\"t\"). .init b = B<T>\n\
         b.q(x) :- p(x). }\n.comp B<S> { .decl q(x: S) .output q\n .decl w(x: symbol) .output w\n w(as(x, S)) :- q(x). }\n\
         .init a = A\n.decl out(x: a.T, y: a.U)\n.output out\nout(x, x) :- a.p(x).\n",
        ".decl a_b_q(x: symbol)\n.decl a_b_w(x: symbol)\n.decl out(x: symbol, y: symbol)\n.output a_b_q, a_b_w, out\n\
         a_b_q(\"t\"). a_b_w(\"t\"). out(\"t\", \"t\").\n",
    ),
    // A type of the instance does not capture an argument of the same name.
    (
        ".type T <: number\n.comp B<S> { .type T <: symbol\n .decl q(x: S, y: T) .output q\n q(1, \"a\"). }\n.init b = B<T>\n",
        ".decl b_q(x: number, y: symbol)\n.output b_q\nb_q(1, \"a\").\n",
    ),
    // Parameters may stand for components: of an instance, and as a base.
    (
        ".comp X { .decl p(x: number) p(1). }\n.comp Y { .decl p(x: number) p(2). }\n.comp Use<C> { .init c = C\n\
         .decl out(x: number) .output out\n out(x) :- c.p(x). }\n.comp More<C> : C { .output p\n p(9). }\n\
         .comp Outer<C> { .init u = Use<C> }\n.init a = Use<X>\n.init b = Use<Y>\n.init c = More<X>\n.init d = Outer<Y>\n",
        ".decl a_out, b_out, c_p, d_u_out(x: number)\n.output a_out, b_out, c_p, d_u_out\na_out(1). b_out(2). c_p(1). c_p(9).\n\
         d_u_out(2).\n",
    ),
    // Components in components; a base may be one beside the component.
    (
        ".comp Outer { .comp Base { .decl p(x: number) p(1). }\n .comp Inner : Base { .output p\n p(2). }\n .init i = Inner }\n\
         .init o = Outer\n.comp Inner { .decl wrong(x: number) }\n",
        ".decl o_i_p(x: number)\n.output o_i_p\no_i_p(1). o_i_p(2).\n",
    ),
    // Expressions, aggregates, negations, alternatives and several heads.
    (
        ".comp A { .decl p, q, s(x: number) .output q, s\n p(1). p(2). p(4).\n \
         q(n), s(n + 1) :- n = count : { p(x), !b.none(x), x > 1 }.\n q(x) :- x = max y : p(y), !s(x).\n .init b = B }\n\
         .comp B { .decl none(x: number) }\n.init a = A\n",
        ".decl a_q, a_s(x: number)\n.output a_q, a_s\na_q(2). a_s(3). a_q(4).\n",
    ),
    // A scope in the program guards nothing in an instance.
    (
        ".decl S(x: number, y: number)\nS(1, 2).\n.decl e(x: number)\ne(1). e(3).\n.comp A { .decl p(x: number, y: number) .output p\n\
         p(x, y) :- e(x), e(y). }\n.init a = A\n.scope S\n",
        ".decl a_p(x: number, y: number)\n.output a_p\na_p(1, 1). a_p(1, 3). a_p(3, 1). a_p(3, 3).\n",
    ),
];

#[test]
fn instances_derive_what_the_clauses_written_out_derive() {
    for (with, without) in PAIRS {
        let (found, wanted) = (outputs(with), outputs(without));
        assert!(!wanted.is_empty() && found == wanted, "{with}\n{found:#?}\n{wanted:#?}");
        let printed = {
            let mut sources = Sources::new();
            let id = sources.add("a.dl", *with);
            print(&parse(&sources, id).file)
        };
        assert_eq!(outputs(&printed), wanted, "{printed}");
        let mut sources = Sources::new();
        let id = sources.add("a.dl", *with);
        let formatted = format(&sources, id).unwrap_or_else(|faults| panic!("{faults:?}"));
        let again = sources.add("a.dl", formatted.clone());
        assert_eq!(format(&sources, again).as_ref(), Ok(&formatted));
        assert_eq!(parse(&sources, id).file, parse(&sources, again).file, "{formatted}");
    }
}

#[test]
fn faults_of_components_have_messages() {
    let cases = [
        (
            ".init a = A\n",
            "unknown-component",
            "1:11",
            "no component `A` is declared",
        ),
        (
            ".comp A : B { }\n.init a = A\n",
            "unknown-component",
            "1:11",
            "no component `B` is declared",
        ),
        (
            ".comp A<T> { }\n.init a = A\n",
            "invalid-component",
            "2:11",
            "the component `A` takes 1 argument, not 0",
        ),
        (
            ".comp A { }\n.init a = A<number>\n",
            "invalid-component",
            "2:11",
            "the component `A` takes 0 arguments, not 1",
        ),
        (
            ".comp A { .init a = A }\n.init a = A\n",
            "invalid-component",
            "1:11",
            "the component `A` has no finite instance",
        ),
        (
            ".comp A { .init b = B .init c = B }\n.comp B { .init a = A .init c = A }\n.init a = A\n",
            "invalid-component",
            "2:11",
            "the component `A` has no finite instance",
        ),
        (
            ".comp A : B { }\n.comp B : A { }\n.init a = A\n",
            "invalid-component",
            "2:11",
            "the component `B` is its own base",
        ),
        (
            ".comp A { }\n.comp A { }\n",
            "duplicate-declaration",
            "2:7",
            "the component `A` is declared twice",
        ),
        (
            ".comp A { }\n.init a = A\n.init a = A\n",
            "duplicate-declaration",
            "3:7",
            "the instance `a` is declared twice",
        ),
        (
            ".comp A { .decl p(x: number) }\n.comp B : A { .override p }\n.init b = B\n",
            "invalid-component",
            "2:25",
            "`p` cannot be overridden",
        ),
        (
            ".comp A { }\n.comp B : A { .override p }\n.init b = B\n",
            "ignored",
            "2:25",
            "`.override p` has no effect",
        ),
        (".override p\n", "syntax", "1:1", "`.override` outside of a component"),
        (
            ".comp A {\n.decl p(x: number)\n",
            "syntax",
            "1:9",
            "the component `A` does not end",
        ),
        (
            ".decl a.p(x: number)\n",
            "syntax",
            "1:7",
            "a name with a dot where a name is declared",
        ),
        (
            ".comp A { .include \"b.dl\" }\n",
            "unsupported",
            "1:20",
            "`.include` in a component is not supported",
        ),
        (
            ".comp A { .decl p(x: number) p(x) :- q(x). }\n.init a = A\n.output a.p\n",
            "unknown-predicate",
            "1:38",
            "no predicate `q` is declared",
        ),
        (
            ".comp A { .decl p(x: T) }\n.init a = A\n.output a.p\n",
            "unknown-type",
            "1:22",
            "no type `T` is declared",
        ),
        (
            ".comp A { .decl p(x: number) }\n.comp B : A { .decl p(x: number) }\n.init b = B\n.output b.p\n",
            "duplicate-declaration",
            "2:21",
            "the predicate `b.p` is declared twice",
        ),
        (
            ".comp A { .decl p(x: number) }\n.init a = A\n.output a.q\n",
            "unknown-predicate",
            "3:9",
            "no predicate `a.q` is declared",
        ),
    ];
    for (text, code, place, message) in cases {
        let found = messages(text);
        let wanted = (code, format!("a.dl:{place}"), message.to_owned());
        assert!(found.contains(&wanted), "{text}\n{found:#?}");
        let others: Vec<_> = found.iter().filter(|one| one.0 == code).collect();
        assert_eq!(others.len(), 1, "{text}\n{found:#?}");
    }
}

#[test]
fn a_message_in_an_instance_names_both_places() {
    let text = "#define ATOM(x) q(x, x)\n.comp A<T> {\n  .decl p(x: T)\n  .decl q(x: T)\n  p(x) :- q(x), q(x, x).\n  p(y) :- ATOM(y).\n}\n\
                .comp B {\n  .init deep = A<symbol>\n}\n.init one = A<number>\n.init two = B\n.output one.p, two.deep.p\n";
    let (sources, loaded) = load(text);
    let found = render(&loaded.diagnostics, &sources, false);
    for part in [
        "error[arity-mismatch]: `one.q` takes 1 argument, not 2",
        "error[arity-mismatch]: `two.deep.q` takes 1 argument, not 2",
        "a.dl:5:17",
        "a.dl:6:11",
        "in the expansion of the macro `ATOM`, defined here",
        ".init one = A<number>\n   | --------------------- in the instance `one` of `A`, made here",
        ".init deep = A<symbol>\n   |   ---------------------- in the instance `two.deep` of `A`, made here",
        ".init two = B\n   | ------------- in the instance `two` of `B`, made here",
    ] {
        let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ").replace("| ", "");
        let bare = |text: &str| words(&text.replace(char::is_numeric, ""));
        assert!(bare(&found).contains(&bare(part)), "{part} is missing in\n{found}");
    }
}

#[test]
fn a_component_without_instance_means_nothing() {
    let text = ".comp A<T> : B { .decl p(x: T, y: U) p(x) :- q(x). .override p\n .init c = D }\n.decl r(x: number)\n.output r\nr(1).\n";
    assert_eq!(messages(text), []);
}

#[test]
fn the_instances_of_a_program_are_bounded() {
    let mut doubled = ".comp C0 { .decl p(x: number) }\n".to_owned();
    let mut bases = doubled.clone();
    for level in 1..40 {
        doubled += &format!(".comp C{level} {{ .init a = C{0} .init b = C{0} }}\n", level - 1);
        bases += &format!(".comp C{level} : C{0}, C{0} {{ }}\n", level - 1);
    }
    let chain: String = (1..10_000)
        .map(|at| format!(".comp C{at} : C{} {{ }}\n", at - 1))
        .collect();
    let nested = ".comp A { ".repeat(100_000);
    let wide: String = (0..3_000).map(|at| format!("p({at}).\n")).collect();
    let wide = format!(".comp A {{ .decl p(x: number)\n{wide}}}\n");
    let inits: String = (0..1_000).map(|at| format!(".init a{at} = A\n")).collect();
    for (text, code) in [
        (format!("{doubled}.init c = C39\n"), "limit-exceeded"),
        (format!("{bases}.init c = C39\n"), "limit-exceeded"),
        (nested, "limit-exceeded"),
        (format!("{chain}.init c = C9999\n"), "limit-exceeded"),
        (format!("{wide}{inits}"), "limit-exceeded"),
    ] {
        let found = messages(&text);
        assert!(found.iter().any(|one| one.0 == code), "{} {found:?}", &text[..40]);
    }
}

#[test]
fn a_program_that_grows_makes_each_instance_once() {
    let read = |_: &Path| Err(ReadError::NotFound);
    let mut sources = Sources::new();
    let mut workspace = Workspace::new(InputPolicy::Extensible);
    for text in [
        ".comp A { .decl p(x: number) p(1). .output p }\n",
        ".init a = A\n",
        ".init b = A\na.p(2).\n",
    ] {
        let id = sources.add("part.dl", text);
        let id = match sources.name(id) {
            _ if text.starts_with(".init b") => sources.add("last.dl", text),
            _ if text.starts_with(".init a") => sources.add("middle.dl", text),
            _ => id,
        };
        workspace.add(&mut sources, id, &read);
    }
    let loaded = workspace.check();
    let rules = loaded.rules.unwrap_or_else(|| panic!("{:?}", loaded.diagnostics));
    let names: Vec<&str> = rules
        .predicates
        .iter()
        .map(|predicate| predicate.name.as_str())
        .collect();
    assert_eq!((names, rules.clauses.len()), (vec!["a.p", "b.p"], 3));
}
