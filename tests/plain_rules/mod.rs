//! Rules for fixed examples and benches, from a line per clause: every column is a number, every name that begins with a small
//! letter a variable.

use logicity::diag::{Sources, Span};
use logicity::engine::Program;
use logicity::lang::{
    Atom, BaseType, Clause, ClauseId, Column, Literal, RelId, Relation, Rules, Stratum, Term, Type, TypeId, Value,
    VarId,
};
use logicity::symbol::Symbols;

/// A program. Each stratum is its clauses, one per line, without full stops; predicates are declared by their first use.
pub fn program(strata: &[&str]) -> Program {
    let mut sources = Sources::new();
    let span = Span::new(sources.add("plain", ""), 0..0);
    let number = |name: &str, base| Type {
        name: name.into(),
        base,
        parent: None,
        doc: String::new(),
    };
    let mut rules = Rules {
        types: vec![number("symbol", BaseType::Symbol), number("number", BaseType::Number)],
        relations: Vec::new(),
        clauses: Vec::new(),
        strata: Vec::new(),
        symbols: Symbols::new(),
    };
    for text in strata {
        let mut stratum = Stratum {
            relations: Vec::new(),
            clauses: Vec::new(),
            recursive: false,
        };
        for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
            let (head, body) = line.split_once(":-").unwrap_or((line, ""));
            let mut variables = Vec::new();
            let head = atom(head, &mut rules, &mut variables, span);
            let body: Vec<Literal> = body
                .split_inclusive(')')
                .map(|literal| literal.trim_start_matches([',', ' ']))
                .filter(|literal| !literal.is_empty())
                .map(|literal| match literal.strip_prefix('!') {
                    Some(literal) => Literal::Negative(atom(literal, &mut rules, &mut variables, span)),
                    None => Literal::Positive(atom(literal, &mut rules, &mut variables, span)),
                })
                .collect();
            rules.relations[head.relation.index()].derived |= !body.is_empty();
            stratum.relations.push(head.relation);
            stratum.clauses.push(ClauseId(rules.clauses.len() as u32));
            rules.clauses.push(Clause {
                head,
                body,
                variables,
                doc: String::new(),
                span,
            });
        }
        stratum.relations.sort_unstable();
        stratum.relations.dedup();
        let mut bodies = stratum
            .clauses
            .iter()
            .flat_map(|clause| &rules.clauses[clause.index()].body);
        stratum.recursive = bodies.any(|literal| match literal {
            Literal::Positive(atom) => stratum.relations.contains(&atom.relation),
            _ => false,
        });
        rules.strata.push(stratum);
    }
    Program::new(rules).expect("the rules are safe")
}

fn atom(text: &str, rules: &mut Rules, variables: &mut Vec<String>, span: Span) -> Atom {
    let (name, terms) = text
        .trim()
        .trim_end_matches(')')
        .split_once('(')
        .expect("an atom has parentheses");
    let term = |text: &str| match text.parse() {
        Ok(number) => Term::Constant(Value::number(number)),
        Err(_) if text == "_" => Term::Wildcard,
        Err(_) => {
            let known = variables.iter().position(|variable| variable == text);
            Term::Variable(VarId(known.unwrap_or_else(|| {
                variables.push(text.into());
                variables.len() - 1
            }) as u32))
        }
    };
    let terms: Vec<Term> = terms
        .split(',')
        .map(str::trim)
        .filter(|term| !term.is_empty())
        .map(term)
        .collect();
    let relation = rules.relation(name).unwrap_or_else(|| {
        let column = |position| Column {
            name: format!("c{position}"),
            ty: TypeId(1),
            base: BaseType::Number,
        };
        rules.relations.push(Relation {
            name: name.into(),
            columns: (0..terms.len()).map(column).collect(),
            doc: String::new(),
            span,
            input: false,
            output: true,
            printsize: false,
            derived: false,
            hidden: false,
        });
        RelId(rules.relations.len() as u32 - 1)
    });
    Atom { relation, terms, span }
}
