//! The words of the language that no file declares: directives, functions, aggregates, operators, also temporal ones,
//! and types.

/// The context of a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Place {
    /// After a full stop at the start of a line.
    Directive,
    /// In the body of a clause.
    Body,
    /// Between two operands, or before one.
    Operator,
    /// After the colon of a column, or in a `.type`.
    Type,
}

/// A word with its notation and meaning.
pub struct Word {
    pub name: &'static str,
    pub place: Place,
    /// An example of its use.
    pub form: &'static str,
    pub meaning: &'static str,
}

const fn word(name: &'static str, place: Place, form: &'static str, meaning: &'static str) -> Word {
    Word {
        name,
        place,
        form,
        meaning,
    }
}

/// Returns the word with this name; directives are without their full stop.
pub fn find(name: &str, directive: bool) -> Option<&'static Word> {
    WORDS
        .iter()
        .find(|word| word.name == name && (word.place == Place::Directive) == directive)
}

use Place::{Body, Directive, Operator, Type};

pub const WORDS: &[Word] = &[
    word(
        "decl",
        Directive,
        ".decl Edge(x: number, y: number)",
        "Declares a predicate with its columns.",
    ),
    word(
        "type",
        Directive,
        ".type place <: symbol",
        "Declares a type: a subtype, an alias, a union, records (`[x: number]`) or branches (`A {x: number} | B {}`).",
    ),
    word(
        "functor",
        Directive,
        ".functor distance(x: symbol, y: symbol): number",
        "Declares a functor that the caller defines in Rust or Python; rules apply it as `@distance(x, y)`.",
    ),
    word(
        "symbol_type",
        Directive,
        ".symbol_type place",
        "Old notation for `.type place <: symbol`.",
    ),
    word(
        "number_type",
        Directive,
        ".number_type speed",
        "Old notation for `.type speed <: number`.",
    ),
    word(
        "input",
        Directive,
        ".input Edge",
        "The rows of the predicate come from outside: a file, or the city.",
    ),
    word(
        "output",
        Directive,
        ".output Path",
        "The rows of the predicate are a result of the program.",
    ),
    word(
        "printsize",
        Directive,
        ".printsize Path",
        "Prints the number of rows of the predicate.",
    ),
    word(
        "limitsize",
        Directive,
        ".limitsize Path(n=1000)",
        "Ends the recursion of the predicate after the round in which it has n rows.",
    ),
    word(
        "pragma",
        Directive,
        ".pragma \"legacy\"",
        "An option of Soufflé, without effect here.",
    ),
    word(
        "plan",
        Directive,
        ".plan 0:(2, 1)",
        "An order of atoms for Soufflé, without effect here.",
    ),
    word(
        "include",
        Directive,
        ".include \"vocabulary.dl\"",
        "Includes a rule file, once.",
    ),
    word("once", Directive, ".once", "Without effect: every file is read once."),
    word(
        "scope",
        Directive,
        ".scope Sees",
        "In the clauses that follow, every variable but the first of the head ranges over the agents that the first one \
         sees. `.scope` alone ends this.",
    ),
    word(
        "comp",
        Directive,
        ".comp Graph<T> { .decl edge(x: T, y: T) }",
        "Declarations and clauses of which `.init` makes instances. Types and components may be parameters, and other \
         components may be bases.",
    ),
    word(
        "init",
        Directive,
        ".init g = Graph<number>",
        "Makes an instance of a component; its predicates have names such as `g.edge`.",
    ),
    word(
        "override",
        Directive,
        ".override path",
        "In a component: replaces the clauses of its bases for a predicate that is `overridable`.",
    ),
    word(
        "disjoint",
        Directive,
        ".disjoint IsCar, IsPedestrian",
        "Constraint: no row is in two of the predicates.",
    ),
    word(
        "implies",
        Directive,
        ".implies IsBus, IsCar",
        "Constraint: every row of the first is one of the second.",
    ),
    word(
        "covering",
        Directive,
        ".covering IsCar, IsPedestrian",
        "Constraint: every value is in one of the predicates.",
    ),
    word(
        "reflexive",
        Directive,
        ".reflexive Sees",
        "Constraint: every value is related to itself.",
    ),
    word(
        "irreflexive",
        Directive,
        ".irreflexive IsClose",
        "Constraint: no value is related to itself.",
    ),
    word(
        "symmetric",
        Directive,
        ".symmetric IsClose",
        "Constraint: with (x, y), (y, x) is a row, too.",
    ),
    word(
        "asymmetric",
        Directive,
        ".asymmetric HigherPri",
        "Constraint: with (x, y), (y, x) is not a row.",
    ),
    word(
        "Not",
        Body,
        "Not(IsCar(X))",
        "Negation: holds if the atom does not. `not` and `!` mean the same.",
    ),
    word(
        "not",
        Body,
        "not IsCar(X)",
        "Negation: holds if the atom does not. `Not` and `!` mean the same.",
    ),
    word("true", Body, "true", "A literal that always holds."),
    word("false", Body, "false", "A literal that never holds."),
    word(
        "previous",
        Body,
        "previous P(x)",
        "Time: holds if the atom held in the tick before.",
    ),
    word(
        "once",
        Body,
        "once[0,5] P(x)",
        "Time: holds if the atom held in some tick of the window; 0 is the present tick, 1 the one before. Without a \
         window: in some tick so far.",
    ),
    word(
        "historically",
        Body,
        "historically[0,5] P(x)",
        "Time: holds if the atom held in every tick of the window; 0 is the present tick, 1 the one before. Before the \
         first tick everything was false.",
    ),
    word(
        "for",
        Body,
        "for[6] P(x)",
        "Time: holds if the atom held in the last six ticks, the present one included.",
    ),
    word(
        "since",
        Body,
        "P(x) since[0,5] Q(x)",
        "Time: holds if the second atom held in some tick of the window, and the first one in every tick after that. \
         Without a window: in some tick so far.",
    ),
    word(
        "match",
        Body,
        "match(pattern, s)",
        "Holds if the regular expression matches the whole symbol.",
    ),
    word(
        "contains",
        Body,
        "contains(part, s)",
        "Holds if the symbol contains the part.",
    ),
    word(
        "count",
        Body,
        "n = count : { Edge(x, _) }",
        "Aggregate: the number of ways in which the body holds.",
    ),
    word(
        "sum",
        Body,
        "n = sum y : { Edge(x, y) }",
        "Aggregate: the sum over all ways in which the body holds.",
    ),
    word(
        "mean",
        Body,
        "n = mean y : { Edge(x, y) }",
        "Aggregate: the mean over all ways in which the body holds.",
    ),
    word(
        "min",
        Body,
        "n = min y : { Edge(x, y) }",
        "Aggregate: the least value for which the body holds. As a function, `min(x, y, ...)` is the least argument.",
    ),
    word(
        "max",
        Body,
        "n = max y : { Edge(x, y) }",
        "Aggregate: the greatest value for which the body holds. As a function, `max(x, y, ...)` is the greatest argument.",
    ),
    word("cat", Body, "cat(s, t, ...)", "Concatenates symbols."),
    word("strlen", Body, "strlen(s)", "The length of a symbol in characters."),
    word(
        "substr",
        Body,
        "substr(s, from, length)",
        "A part of a symbol; positions count from 0.",
    ),
    word(
        "autoinc",
        Body,
        "autoinc()",
        "A number of its own for each solution of the body.",
    ),
    word(
        "ord",
        Body,
        "ord(s)",
        "The internal number of a symbol, valid within one run.",
    ),
    word(
        "to_number",
        Body,
        "to_number(x)",
        "Converts a symbol or another number to `number`.",
    ),
    word(
        "to_unsigned",
        Body,
        "to_unsigned(x)",
        "Converts a symbol or another number to `unsigned`.",
    ),
    word(
        "to_float",
        Body,
        "to_float(x)",
        "Converts a symbol or another number to `float`.",
    ),
    word("to_string", Body, "to_string(x)", "Converts a number to a symbol."),
    word(
        "nil",
        Body,
        "x = nil",
        "The record without fields that every record type has.",
    ),
    word("as", Body, "as(x, type)", "Reinterprets x as a value of the type."),
    word(
        "range",
        Body,
        "range(from, to, step)",
        "Takes the values from, from + step, ..., up to but excluding `to`.",
    ),
    word("lor", Operator, "x lor y", "Logical or: 0 or 1."),
    word("lxor", Operator, "x lxor y", "Logical exclusive or: 0 or 1."),
    word("land", Operator, "x land y", "Logical and: 0 or 1."),
    word("lnot", Operator, "lnot x", "Logical not: 0 or 1."),
    word("bor", Operator, "x bor y", "Bitwise or."),
    word("bxor", Operator, "x bxor y", "Bitwise exclusive or."),
    word("band", Operator, "x band y", "Bitwise and."),
    word("bnot", Operator, "bnot x", "Bitwise not."),
    word("bshl", Operator, "x bshl y", "Shifts the bits left."),
    word(
        "bshr",
        Operator,
        "x bshr y",
        "Shifts the bits right and keeps the sign.",
    ),
    word(
        "bshru",
        Operator,
        "x bshru y",
        "Shifts the bits right and fills with zeros.",
    ),
    word("symbol", Type, "x: symbol", "A quoted string."),
    word("number", Type, "x: number", "A signed integer of 32 bits."),
    word("unsigned", Type, "x: unsigned", "An unsigned integer of 32 bits."),
    word(
        "float",
        Type,
        "x: float",
        "A floating-point number of single precision.",
    ),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::datalog::ast::Operator;
    use crate::datalog::{AggregateOp, BaseType, DIRECTIVES, Functor, parse};
    use crate::diag::Sources;

    #[test]
    fn every_word_of_the_language_is_described() {
        for directive in DIRECTIVES {
            assert!(find(directive, true).is_some(), "{directive}");
        }
        let bases = BaseType::ALL.map(BaseType::name);
        let names = AggregateOp::ALL
            .iter()
            .map(|op| op.name())
            .chain(bases)
            .chain(Functor::words())
            .chain(Operator::ALL.map(Operator::word));
        for name in names {
            assert!(find(name, false).is_some(), "{name}");
        }
        let mut seen = std::collections::HashSet::new();
        assert!(WORDS.iter().all(|word| seen.insert((word.name, word.place))));
    }

    /// The forms are valid code.
    #[test]
    fn every_form_parses() {
        let literals = ["match", "contains", "true", "false"];
        let literals = [&literals[..], &Operator::ALL.map(Operator::word)].concat();
        let known = |word: &&Word| word.place != Directive || DIRECTIVES.contains(&word.name);
        for word in WORDS.iter().filter(known) {
            let text = match word.place {
                Directive if word.name == "override" => format!(".comp B : A {{ {} }}", word.form),
                Directive => word.form.to_owned(),
                Type => format!(".decl A({})", word.form),
                Operator => format!("A(x) :- x = {}.", word.form),
                Body if word.form.contains('=') || word.form.contains("Not(") || word.form.contains("not ") => {
                    format!("A(x) :- {}.", word.form)
                }
                Body if literals.contains(&word.name) => format!("A(x) :- {}.", word.form),
                Body => format!("A(x) :- x = {}.", word.form.replace(", ...", "")),
            };
            let mut sources = Sources::new();
            let id = sources.add("a.dl", text.as_str());
            let parsed = parse(&sources, id);
            let errors = parsed.diagnostics.iter().filter(|fault| fault.is_error()).count();
            assert_eq!(errors, 0, "{text}: {:?}", parsed.diagnostics);
        }
    }
}
