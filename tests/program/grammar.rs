//! The TextMate grammar: every expression compiles, it knows every directive, and every word of a rule file gets a
//! scope.

use logicity::datalog::ast::Operator;
use logicity::datalog::{DIRECTIVES, parse};
use logicity::diag::Sources;
use regex::Regex;
use serde_json::Value;
use std::fs;
use std::path::PathBuf;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn grammar() -> Value {
    let text = fs::read_to_string(root().join("rules/logicity.tmLanguage.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

/// A rule of the grammar: its expression and its scopes. A rule with an end contains others.
struct Rule {
    begin: Regex,
    name: Option<String>,
    captures: Vec<(usize, String)>,
    /// The scopes of the match of its end.
    end_name: Option<String>,
    block: Option<(Regex, Vec<Rule>)>,
}

/// The rules of a list of patterns. Follows includes.
fn rules(patterns: &Value, repository: &Value) -> Vec<Rule> {
    let mut found = Vec::new();
    for pattern in patterns.as_array().unwrap() {
        if let Some(include) = pattern["include"].as_str() {
            let target = &repository[include.trim_start_matches('#')];
            assert!(target.is_object(), "{include} is not in the repository");
            if target["match"].is_string() || target["begin"].is_string() {
                found.extend(rules(&Value::Array(vec![target.clone()]), repository));
            } else {
                found.extend(rules(&target["patterns"], repository));
            }
            continue;
        }
        let regex = |key: &str| pattern[key].as_str().map(|text| Regex::new(text).unwrap());
        let captures = |key: &str| {
            let list = pattern[key].as_object().into_iter().flatten();
            list.map(|(number, scope)| (number.parse().unwrap(), scope["name"].as_str().unwrap().to_owned()))
                .collect()
        };
        let name = pattern["name"].as_str().map(str::to_owned);
        let end_name = pattern["endCaptures"]["0"]["name"]
            .as_str()
            .map(str::to_owned)
            .or(name.clone());
        found.push(match regex("match") {
            Some(begin) => Rule {
                begin,
                name,
                captures: captures("captures"),
                end_name,
                block: None,
            },
            None => {
                let inner = match pattern["patterns"].is_array() {
                    true => rules(&pattern["patterns"], repository),
                    false => Vec::new(),
                };
                Rule {
                    begin: regex("begin").unwrap(),
                    name,
                    captures: captures("beginCaptures"),
                    end_name,
                    block: Some((regex("end").unwrap(), inner)),
                }
            }
        });
    }
    found
}

/// The scope of every byte, as an editor finds it: the rule with the earliest match wins, and among those the first in
/// the list.
fn scopes_of(text: &str, rules: &[Rule]) -> Vec<Option<String>> {
    let mut scopes = vec![None; text.len()];
    let mut offset = 0;
    let mut open: Option<&Rule> = None;
    for line in text.split_inclusive('\n') {
        let code = line.trim_end_matches('\n');
        let mut at = 0;
        loop {
            let list = match open {
                Some(Rule {
                    block: Some((_, inner)),
                    ..
                }) => inner.as_slice(),
                _ => rules,
            };
            let end = open
                .and_then(|rule| rule.block.as_ref())
                .and_then(|(end, _)| end.find_at(code, at));
            let next = list
                .iter()
                .filter_map(|rule| rule.begin.captures_at(code, at).map(|captures| (rule, captures)))
                .min_by_key(|(_, captures)| captures.get(0).unwrap().start());
            let start = next.as_ref().map(|(_, captures)| captures.get(0).unwrap().start());
            if let (Some(rule), Some(end)) = (open, end)
                && start.is_none_or(|start| end.start() <= start)
            {
                for scope in &mut scopes[offset + at..offset + end.start()] {
                    *scope = scope.clone().or(rule.name.clone());
                }
                scopes[offset + end.start()..offset + end.end()].fill(rule.end_name.clone());
                open = None;
                at = end.end();
                continue;
            }
            let Some((rule, captures)) = next else {
                if let Some(rule) = open {
                    for scope in &mut scopes[offset + at..offset + code.len()] {
                        *scope = scope.clone().or(rule.name.clone());
                    }
                }
                break;
            };
            let whole = captures.get(0).unwrap();
            for scope in &mut scopes[offset + whole.start()..offset + whole.end()] {
                *scope = rule.name.clone().or(open.and_then(|open| open.name.clone()));
            }
            for (number, name) in &rule.captures {
                if let Some(part) = captures.get(*number) {
                    scopes[offset + part.start()..offset + part.end()].fill(Some(name.clone()));
                }
            }
            if rule.block.is_some() {
                open = Some(rule);
            }
            at = whole.end().max(at + usize::from(whole.is_empty()));
            if at > code.len() {
                break;
            }
        }
        offset += line.len();
    }
    scopes
}

fn scope_of<'s>(text: &str, scopes: &'s [Option<String>], word: &str) -> &'s str {
    let at = text.find(word).unwrap_or_else(|| panic!("no {word}"));
    scopes[at].as_deref().unwrap_or("")
}

#[test]
fn words_get_their_scopes() {
    let grammar = grammar();
    let rules = rules(&grammar["patterns"], &grammar["repository"]);
    let text = r#"/// doc
.decl Car(x: agent, v: number) // why
.type agent <: symbol
.disjoint Car, Walker
Stop(X) :- Car(X, 0x2A), Car(Y, 10.0.0.1), Car(Y, 2.5e-3), Car(Y, 7u), Not(IsBus(X)), !Near(X, _), X != "a\"b", /* block */ X = "c".
"#;
    let scopes = scopes_of(text, &rules);
    for (word, scope) in [
        ("/// doc", "comment.line.documentation"),
        (".decl", "keyword.control.directive"),
        ("Car", "entity.name.function"),
        ("agent", "storage.type"),
        ("v:", "variable.parameter"),
        ("// why", "comment.line.double-slash"),
        (".type", "keyword.control.directive"),
        ("<:", "keyword.operator"),
        (".disjoint", "keyword.control.directive"),
        ("Stop", "entity.name.function"),
        (":-", "keyword.operator.rule"),
        ("0x2A", "constant.numeric"),
        ("10.0.0.1", "constant.numeric"),
        ("2.5e-3", "constant.numeric"),
        ("-3)", "constant.numeric"),
        ("7u", "constant.numeric"),
        ("Not(", "keyword.operator.logical.negation"),
        ("IsBus", "entity.name.function"),
        ("!Near", "keyword.operator.logical.negation"),
        ("_)", "variable.language.wildcard"),
        ("!= ", "keyword.operator.comparison"),
        ("\"a", "string.quoted.double"),
        ("/* block", "comment.block"),
        ("\"c\"", "string.quoted.double"),
    ] {
        let found = scope_of(text, &scopes, word);
        assert!(found.starts_with(scope), "`{word}` is {found}, not {scope}");
    }
}

#[test]
fn every_word_of_the_shipped_rules_has_a_scope() {
    let grammar = grammar();
    let rules = rules(&grammar["patterns"], &grammar["repository"]);
    for entry in fs::read_dir(root().join("rules")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "dl") {
            continue;
        }
        let text = fs::read_to_string(&path).unwrap();
        for (at, scope) in scopes_of(&text, &rules).iter().enumerate() {
            let blank = text.as_bytes()[at].is_ascii_whitespace();
            assert!(
                blank || scope.is_some(),
                "{}: nothing for `{}`",
                path.display(),
                &text[at..text.len().min(at + 20)]
            );
        }
    }
}

/// The grammar knows every directive that the parser knows.
#[test]
fn every_directive_is_a_keyword() {
    let grammar = grammar();
    let rules = rules(&grammar["patterns"], &grammar["repository"]);
    for name in DIRECTIVES {
        let text = format!(".{name} a");
        let scopes = scopes_of(&text, &rules);
        assert_eq!(
            scope_of(&text, &scopes, "."),
            "keyword.control.directive.logicity",
            ".{name}"
        );
    }
}

/// The words of temporal operators are keywords before an atom, and names elsewhere.
#[test]
fn temporal_operators_are_keywords() {
    let grammar = grammar();
    let rules = rules(&grammar["patterns"], &grammar["repository"]);
    for operator in Operator::ALL {
        let word = operator.word();
        let bare = !matches!(operator, Operator::Historically | Operator::For);
        let windows = if operator == Operator::Previous { "" } else { "[0,5]" };
        let texts = [(true, windows), (bare, "")];
        for (_, window) in texts.iter().filter(|(takes, _)| *takes) {
            let text = format!("A(x) :- B(x), Q(x) {word}{window} P(x).");
            let scopes = scopes_of(&text, &rules);
            for (part, scope) in [
                (word, "keyword.operator.temporal.logicity"),
                ("P(", "entity.name.function.logicity"),
            ] {
                assert_eq!(scope_of(&text, &scopes, part), scope, "{part} in {text}");
            }
            let shown = text
                .bytes()
                .zip(&scopes)
                .all(|(byte, scope)| byte == b' ' || scope.is_some());
            assert!(shown, "{text}: {scopes:?}");
        }
        let text = format!("A(x) :- {word}(x).");
        let scopes = scopes_of(&text, &rules);
        assert_eq!(scope_of(&text, &scopes, word), "entity.name.function.logicity");
    }
}

/// The extension for Visual Studio Code uses this grammar for the files of the language, and its snippets are valid
/// code.
#[test]
fn the_extension_fits_the_grammar() {
    let folder = root().join("editors/vscode");
    let json = |path: PathBuf| -> Value {
        let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    };
    let package = json(folder.join("package.json"));
    let contributes = &package["contributes"];
    let (language, used) = (&contributes["languages"][0], &contributes["grammars"][0]);
    assert_eq!(used["scopeName"], grammar()["scopeName"]);
    assert_eq!(
        (&used["language"], &contributes["snippets"][0]["language"]),
        (&language["id"], &language["id"])
    );
    let endings = grammar()["fileTypes"].as_array().unwrap().clone();
    let endings: Vec<String> = endings
        .iter()
        .map(|ending| format!(".{}", ending.as_str().unwrap()))
        .collect();
    assert_eq!(language["extensions"], serde_json::json!(endings));
    // `make vscode` copies the grammar, so that there is one file.
    let path = used["path"].as_str().unwrap().trim_start_matches("./");
    assert!(root().join("rules").join(path).exists());
    let makefile = fs::read_to_string(root().join("Makefile")).unwrap();
    assert!(makefile.contains(&format!("cp rules/{path} ")));
    for file in [
        &package["main"],
        &language["configuration"],
        &contributes["snippets"][0]["path"],
    ] {
        assert!(folder.join(file.as_str().unwrap()).exists(), "{file}");
    }
    assert_eq!(package["version"], env!("CARGO_PKG_VERSION"));
    let script = fs::read_to_string(folder.join("extension.js")).unwrap();
    for command in contributes["commands"].as_array().unwrap() {
        assert!(script.contains(command["command"].as_str().unwrap()));
    }

    let settings = json(folder.join("language-configuration.json"));
    assert!(
        Regex::new(settings["wordPattern"].as_str().unwrap())
            .unwrap()
            .is_match("IsCar")
    );
    let placeholder = Regex::new(r"\$\{\d+(?::([^}]*)|\|([^,|]*)[^}]*)\}|\$0").unwrap();
    for (name, snippet) in json(folder.join("snippets.json")).as_object().unwrap() {
        let lines = match &snippet["body"] {
            Value::String(line) => line.clone(),
            lines => lines
                .as_array()
                .unwrap()
                .iter()
                .map(|line| line.as_str().unwrap().to_owned() + "\n")
                .collect(),
        };
        let filled = placeholder.replace_all(&lines, "$1$2");
        let is_literal = !filled.contains(".decl") && !filled.contains(":-");
        let text = if is_literal {
            format!("A(x) :- {filled}.")
        } else {
            filled.into_owned()
        };
        let mut sources = Sources::new();
        let id = sources.add("snippet.dl", text.as_str());
        assert!(parse(&sources, id).diagnostics.is_empty(), "{name}:\n{text}");
    }
}
