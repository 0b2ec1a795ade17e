//! Hostile files and command lines: every command and option with values and files that are wrong, huge or malicious.
//!
//! Each case is a shell command line in which `@` stands for the program; without `@`, it is the arguments of the
//! program. A case has 2 GB of address space and 20 seconds. It must end with its exit code and print its words,
//! without a panic, an abort or a hang. No file that existed before may change: neither its bytes nor its permissions,
//! nor where a link leads.

use crate::files::rules_hash;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// The address space of a command, in KiB.
const MEMORY: u32 = 2 << 20;
/// The time for a command.
const TIME: Duration = Duration::from_secs(20);
/// The commands that run at the same time.
const THREADS: usize = 2;

/// A command line, the exit code, and words of the message (in standard output or standard error).
type Case = (&'static str, i32, &'static str);

const CHECK: &[Case] = &[
    ("", 2, "Usage"),
    ("nonsense", 2, "unrecognized subcommand"),
    ("--nonsense", 2, "unexpected argument"),
    ("check", 2, "FILES"),
    ("check ''", 2, "a value is required"),
    ("check missing.dl", 2, "missing.dl"),
    ("check \"$(printf 'missing\\377.dl')\"", 2, "missing"),
    ("check folder", 2, "folder"),
    ("check good.dl/inside.dl", 2, "good.dl/inside.dl"),
    ("check loop.dl", 2, "loop.dl"),
    ("check dangling.dl", 2, "a symbolic link to `nowhere/nothing.dl`"),
    ("check names/first.dl", 1, "too many included files"),
    ("check zero.dl", 2, "it is a device"),
    ("check all.dl", 1, "\"for all\" counts the exceptions"),
    ("check equation.dl", 1, "write it in quotes: `\"Car_2\"`"),
    ("check latin1.dl", 1, "not-text"),
    ("check utf16.dl", 1, "U+0000"),
    ("check nul.dl", 1, "nul.dl:1"),
    ("check empty.dl", 0, "0 clauses"),
    ("check comment.dl", 1, "comment.dl"),
    ("check string.dl", 1, "string.dl"),
    ("check bom.dl", 0, "1 clause"),
    ("check crlf.dl", 0, "1 clause"),
    ("check picture.png", 1, "not-text"),
    ("check deep-parentheses.dl", 1, "limit-exceeded"),
    ("check deep-aggregates.dl", 1, "limit-exceeded"),
    ("check deep-negation.dl", 1, "error"),
    ("check number.dl", 1, "number.dl:1"),
    ("check float.dl", 1, "float.dl"),
    ("check wide.dl", 1, "error"),
    ("check alternatives.dl", 1, "limit-exceeded"),
    ("check faults.dl", 1, "errors"),
    ("check variables.dl", 1, "the maximum is 128"),
    ("check names.dl", 1, "names.dl"),
    ("check negation.dl", 1, "cyclic-negation"),
    ("check regex.dl", 0, "2 clauses"),
    ("check include-self.dl", 1, "include-cycle"),
    ("check include-folder.dl", 1, "missing-include"),
    ("check include-missing.dl", 1, "missing-include"),
    ("check include-chain-0.dl", 1, "nested too deeply"),
    ("check include-up.dl", 1, "missing-include"),
    ("check include-device.dl", 1, "missing-include"),
    ("check include-pipe.dl", 1, "pipe or a device"),
    ("check include-passwd.dl", 1, "/etc/passwd:1:5"),
    ("check - < folder", 2, "cannot read"),
    ("check good.dl missing.dl folder", 2, "missing.dl"),
    ("check --json latin1.dl nul.dl", 1, "not-text"),
    ("check --lints deep-parentheses.dl", 1, "limit-exceeded"),
    ("check --config easy good.dl", 1, "rule-mismatch"),
    ("check --coverage missing.jsonl", 2, "missing.jsonl"),
    ("check --coverage folder", 2, "folder"),
    ("check --coverage empty.dl", 1, "empty"),
    ("check --coverage picture.png", 1, "not-text"),
    ("check --coverage deep.json", 1, "not the header"),
    ("check --coverage trace.jsonl missing.dl", 2, "missing.dl"),
    ("check --coverage trace.jsonl --config missing.yaml", 2, "missing.yaml"),
    ("check --coverage trace-version.jsonl", 1, "invalid-trace"),
    ("check --coverage trace-cycle.jsonl", 1, "error"),
    ("check good.dl > /dev/full", 2, "standard output"),
    ("check --json good.dl > /dev/full", 2, "standard output"),
    ("--help > /dev/full", 2, "standard output"),
];

const FORMAT: &[Case] = &[
    ("fmt", 2, "RULES"),
    ("fmt ''", 2, "a value is required"),
    ("fmt missing.dl", 2, "missing.dl"),
    ("fmt folder", 2, "folder"),
    ("fmt loop.dl", 2, "loop.dl"),
    ("fmt dangling.dl", 2, "a symbolic link to `nowhere/nothing.dl`"),
    ("fmt zero.dl", 2, "it is a device"),
    ("fmt latin1.dl", 1, "not-text"),
    ("fmt nul.dl", 1, "nul.dl"),
    ("fmt large.dl", 1, "rule file too large"),
    ("fmt faults.dl", 1, "errors"),
    ("fmt deep-parentheses.dl", 1, "limit-exceeded"),
    ("fmt rules/vocabulary.dl", 0, ""),
    ("fmt --check unformatted.dl", 1, "unformatted.dl"),
    ("fmt --check nul.dl", 1, "nul.dl"),
    ("head -c 100000 /dev/zero | @ fmt -", 1, "error"),
    ("printf '\\377' | @ fmt -", 1, "UTF-8"),
    ("printf '' | @ fmt -", 0, ""),
    ("printf 'A(1).' | @ fmt - > /dev/full", 2, "standard output"),
    ("fmt good.dl -- --check", 2, "--check"),
];

const DIFF: &[Case] = &[
    ("diff", 2, "LEFT"),
    ("diff good.dl", 2, "RIGHT"),
    ("diff good.dl missing.dl", 2, "missing.dl"),
    ("diff missing.dl good.dl", 2, "missing.dl"),
    ("diff good.dl folder", 2, "folder"),
    ("diff good.dl nul.dl", 1, "nul.dl"),
    ("diff good.dl latin1.dl", 1, "not-text"),
    ("diff expert hrad", 2, "hrad"),
    ("diff good.dl good.dl --entities -1", 2, "-1"),
    (
        "diff good.dl good.dl --entities 99999999999999999999",
        2,
        "99999999999999999999",
    ),
    ("diff good.dl good.dl --entities NaN", 2, "NaN"),
    ("diff good.dl good.dl --entities ''", 2, "--entities"),
    (
        "diff rules/expert.dl rules/hard.dl --entities 1000000",
        1,
        "smallest scene",
    ),
    ("diff good.dl good.dl --effort -1", 2, "-1"),
    ("diff good.dl good.dl --effort 1e9", 2, "1e9"),
    ("diff good.dl good.dl --predicates ''", 2, "predicate"),
    ("diff good.dl good.dl --predicates Missing", 2, "Missing"),
    ("diff rules/expert.dl rules/hard.dl > /dev/full", 2, "standard output"),
];

const SHORTCUTS: &[Case] = &[
    ("shortcuts", 2, "RULES"),
    ("shortcuts missing.dl", 2, "missing.dl"),
    ("shortcuts folder", 2, "folder"),
    ("shortcuts latin1.dl", 1, "not-text"),
    ("shortcuts nul.dl", 1, "nul.dl"),
    ("shortcuts large.dl", 1, "rule file too large"),
    ("shortcuts deep-parentheses.dl", 1, "limit-exceeded"),
    ("shortcuts hrad", 2, "hrad"),
    ("shortcuts rules/easy.dl --config hrad", 2, "hrad"),
    ("shortcuts easy --entities 0", 2, "0"),
    (
        "shortcuts easy --entities 99999999999999999999",
        2,
        "99999999999999999999",
    ),
    ("shortcuts expert --entities 9", 2, "9"),
    ("shortcuts easy --effort -1", 2, "-1"),
    ("shortcuts easy --limit 0", 2, "0"),
    ("shortcuts easy --concepts ''", 2, "concept"),
    ("shortcuts easy > /dev/full", 2, "standard output"),
];

const QUERY: &[Case] = &[
    ("query", 2, "RULES"),
    ("query missing.dl", 2, "missing.dl"),
    ("query outputs.dl -D many", 0, "wrote many/P3999.csv"),
    ("query good.dl -D records/kernel", 2, "the system generates its content"),
    ("query folder", 2, "folder"),
    ("query nul.dl", 1, "nul.dl"),
    ("query input.dl -F missing", 2, "missing"),
    ("query input.dl -F good.dl", 2, "good.dl"),
    ("query input.dl -F folder", 2, "A.facts"),
    ("query input.dl -F facts/latin1 -D -", 1, "not-text"),
    ("query input.dl -F facts/nul -D -", 1, "invalid-fact"),
    ("query input.dl -F facts/wide -D -", 1, "invalid-fact"),
    ("query input.dl -F facts/large -D -", 1, "invalid-fact"),
    ("query input.dl -F facts/digits -D -", 1, "invalid-fact"),
    ("query input.dl -F facts/crlf -D -", 0, "2"),
    ("query input.dl -F facts/bom -D -", 1, "invalid-fact"),
    ("query input.dl -F facts/faults -D -", 1, "errors"),
    ("query input.dl -F facts/folder -D -", 2, "folder"),
    ("query input.dl -F facts/pipe -D -", 2, "pipe or a device"),
    ("query input.dl -F facts/loop -D -", 2, "A.facts"),
    ("query input.dl -F facts/gzip -D -", 0, "A"),
    ("query input.dl -F facts/cut -D -", 2, "facts/cut/A.facts"),
    ("query text.dl -F facts/text -D -", 0, "S"),
    ("query device.dl -D -", 2, "pipe or a device"),
    ("query good.dl -D good.dl", 2, "good.dl"),
    ("query good.dl -D /dev/full", 2, "/dev/full"),
    ("query good.dl -D /dev/null/inside", 2, "/dev/null"),
    ("query good.dl -D ''", 2, "a value is required"),
    ("query good.dl -D foreign", 2, "foreign/A.csv"),
    ("query good.dl -D linked", 1, "outside of the folder of results"),
    ("query good.dl -D taken", 2, "not a regular file"),
    ("query outside.dl -D folder", 1, "outside of the folder of results"),
    ("query itself.dl -D . --force", 2, "this command reads it"),
    (
        "query rows.dl -F facts/crlf -D facts/crlf --force",
        2,
        "this command reads it",
    ),
    ("query zero.dl", 2, "it is a device"),
    ("query good.dl -D - > /dev/full", 2, "standard output"),
    ("query good.dl --explain", 2, "--explain"),
    ("query good.dl --explain ''", 2, "error"),
    ("query good.dl --explain 'A('", 2, "error"),
    ("query good.dl --explain 'B(1)'", 2, "B"),
    ("query good.dl --explain 'A(99999999999999999999)'", 2, "error"),
    ("query good.dl --explain 'A(1), A(2)'", 2, "error"),
    ("query good.dl --explain \"$(printf 'A(\\377)')\"", 2, "UTF-8"),
    (
        "query good.dl --why-not \"$(head -c 100000 /dev/zero | tr '\\0' '(')\"",
        2,
        "error",
    ),
    ("query good.dl --explain 'A(1)' --why-not 'A(1)'", 2, "cannot be used"),
    ("query good.dl --json", 2, "--json requires"),
    ("query good.dl --plan --profile", 2, "cannot be used"),
    ("query good.dl --threads -1", 2, "1024"),
    ("query good.dl --threads 99999999999999999999", 2, "1024"),
    ("query good.dl --threads 1e3", 2, "1024"),
    ("query good.dl --threads ''", 2, "1024"),
    ("query good.dl --max-rows -1", 2, "nonnegative"),
    ("query good.dl --max-rows NaN", 2, "nonnegative"),
    ("query good.dl --max-rows 1e99", 2, "nonnegative"),
    ("query good.dl -D - --max-rows 99999999999T", 0, "A"),
    ("query derived.dl --max-rows 0 -D -", 1, "--max-rows"),
    ("query good.dl --max-steps inf", 2, "nonnegative"),
    ("query good.dl --max-memory -5", 2, "MiB"),
    ("query good.dl --max-memory 5X", 2, "MiB"),
    ("query derived.dl --max-memory 0 -D -", 1, "--max-memory"),
    ("query endless.dl --max-rows 100K -D -", 1, "--max-rows"),
    ("query endless.dl --max-memory 1M -D -", 1, "--max-memory"),
    ("query text-endless.dl --max-memory 100M -D -", 1, "bound them"),
    ("query product.dl --max-steps 10M -D -", 1, "--max-steps"),
    ("query range.dl --max-rows 100K -D -", 1, "--max-rows"),
    ("query arithmetic.dl -D -", 0, "A"),
    ("query regex.dl -D -", 0, "A"),
    ("query substr.dl -D -", 0, "A"),
];

const REPL: &[Case] = &[
    ("repl missing.dl < empty.dl", 2, "missing.dl"),
    ("repl folder < empty.dl", 2, "folder"),
    ("repl good.dl -F missing < empty.dl", 2, "missing"),
    ("repl < empty.dl", 0, ""),
    ("repl < faults.dl", 1, "error"),
    ("repl < nul.dl", 1, "error"),
    ("repl < latin1.dl", 1, "not-text"),
    ("repl < picture.png", 1, "not-text"),
    ("repl < deep-parentheses.dl", 1, "limit-exceeded"),
    ("repl < folder", 2, "cannot read"),
    (
        "printf '.load missing.dl\\n.load folder\\n.load\\n' | @ repl",
        1,
        "missing.dl",
    ),
    ("printf '.facts missing\\n' | @ repl", 1, "missing"),
    ("printf '.nonsense\\n?-\\n?- A(\\n' | @ repl", 1, "nonsense"),
    (
        "printf '.decl N(x: number)\\nN(0).\\nN(X + 1) :- N(X).\\n' | @ repl --max-rows 10K",
        1,
        "bound them",
    ),
    ("printf '.load include-pipe.dl\\n' | @ repl", 1, "pipe or a device"),
    (
        "printf '.decl A(x: number)\\n+A(99999999999999999999).\\n' | @ repl",
        1,
        "error",
    ),
    ("repl --max-rows -1 < empty.dl", 2, "nonnegative"),
    ("printf '.help\\n' | @ repl > /dev/full", 1, ""),
    ("printf 'A(1) :- B(\\n.help\\n.quit\\n' | @ repl", 1, ".predicates"),
    ("printf '/* .quit\\n.quit\\n' | @ repl", 1, "error"),
];

const INFER: &[Case] = &[
    ("infer missing.jsonl", 2, "missing.jsonl"),
    ("infer folder", 2, "folder"),
    ("infer empty.dl", 0, ""),
    ("infer picture.png", 1, "not-text"),
    ("infer latin1.dl", 1, "not-text"),
    ("infer utf16.dl", 1, "invalid-scene"),
    ("infer nul.dl", 1, "not a file of scenes"),
    ("infer deep.json", 1, "invalid-scene"),
    ("infer huge-line.json", 1, "limit-exceeded"),
    ("printf '{}' | @ infer", 1, "entities"),
    ("printf 'null\\n[]\\n1\\n\"\"\\n' | @ infer", 1, "invalid-scene"),
    ("printf '{\"entities\":{}' | @ infer", 1, "invalid-scene"),
    ("printf '\\357\\273\\277{}' | @ infer", 1, "invalid-scene"),
    ("printf '{\"entities\":NaN}' | @ infer", 1, "invalid-scene"),
    (
        "printf '{\"entities\":[],\"entities\":[]}' | @ infer",
        1,
        "invalid-scene",
    ),
    (
        "printf '{\"entities\":{\"A\":{\"type\":\"Car\",\"priority\":1e999}}}' | @ infer",
        1,
        "invalid-scene",
    ),
    (
        "printf '{\"entities\":{\"A\":{\"type\":\"Bird\"}}}' | @ infer",
        1,
        "Bird",
    ),
    ("infer entities.json", 1, "error"),
    ("printf '{}' | @ infer --config missing.yaml", 2, "missing.yaml"),
    ("printf '{}' | @ infer --config folder", 2, "it is a folder"),
    ("printf '{}' | @ infer --rules missing.dl", 2, "missing.dl"),
    ("printf '{}' | @ infer --rules good.dl", 1, "error"),
    ("printf '{}' | @ infer --seed -1", 2, "-1"),
    ("printf '{}' | @ infer --seed 99999999999999999999", 2, "--seed"),
    ("printf '{}' | @ infer --executor nonsense", 2, "nonsense"),
    (
        "printf '{}' | @ infer --executor dense --check-constraints",
        2,
        "relational",
    ),
    ("printf '{}' | @ infer --out folder", 2, "not a regular file"),
    ("printf '{}' | @ infer --out good.dl", 2, "--force"),
    ("printf '{}' | @ infer --out /dev/full", 2, "No space left"),
    ("printf '{}' | @ infer --out pipe", 2, "not a regular file"),
    ("printf '{}' | @ infer --out - > /dev/full", 2, "standard output"),
    ("infer empty.dl --out empty.dl --force", 2, "this command reads it"),
    ("infer --out empty.dl --force < empty.dl", 2, "this command reads it"),
    (
        "infer empty.dl --rules city.dl --out city.dl --force",
        2,
        "this command reads it",
    ),
    (
        "infer empty.dl --rules city.dl --out linked-city.dl --force",
        2,
        "this command reads it",
    ),
    ("infer empty.dl --out -", 0, ""),
    ("infer empty.dl --out /dev/stdout", 0, ""),
    ("infer empty.dl --out /dev/null", 0, ""),
    ("infer zero.dl", 2, "it is a device"),
    ("infer empty.dl --config zero", 2, "it is a device"),
    ("infer empty.dl --rules zero.dl", 2, "it is a device"),
    (
        "infer ego.json --rules runaway.dl --max-rows 10K",
        1,
        "raise the limit with `--max-rows`",
    ),
    (
        "infer ego.json --rules runaway.dl --max-steps 100K",
        1,
        "raise the limit with `--max-steps`",
    ),
    (
        "infer ego.json --rules runaway.dl --max-memory 1M",
        1,
        "raise the limit with `--max-memory`",
    ),
    ("infer ego.json --max-steps -1", 2, "nonnegative"),
    (
        "infer --seed -99999999999999999999",
        2,
        "from 0 to 18446744073709551615",
    ),
    ("printf '{}' | @ infer --out loop.dl", 2, "symbolic links"),
    ("printf '{}' | @ infer --out missing/answers.jsonl", 2, "no folder"),
    ("printf '{}' | @ infer --out ''", 2, "a value is required"),
    ("printf '{}' | @ infer > /dev/full", 2, "standard output"),
];

const RUN: &[Case] = &[
    ("run", 2, "CONFIG"),
    ("run '' --no-trace", 2, "a value is required"),
    ("run missing --no-trace", 2, "missing"),
    ("run missing.yaml --no-trace", 2, "missing.yaml"),
    ("run folder --no-trace", 2, "it is a folder"),
    ("run latin1.dl --no-trace", 1, "rule file"),
    ("run picture.png --no-trace", 1, "not-text"),
    ("run empty.dl --no-trace", 1, "rule file"),
    ("run nul.dl --no-trace", 1, "error"),
    ("run yaml/bomb.yaml --no-trace", 1, "limit-exceeded"),
    ("run yaml/deep.yaml --no-trace", 1, "error"),
    ("run yaml/deep-flow.yaml --no-trace", 1, "error"),
    ("run yaml/large.yaml --no-trace", 1, "limit-exceeded"),
    ("run yaml/tab.yaml --no-trace", 1, "yaml-syntax"),
    ("run yaml/duplicate.yaml --no-trace", 1, "duplicate-key"),
    ("run yaml/keys.yaml --no-trace", 1, "error"),
    ("run yaml/list.yaml --no-trace", 1, "run configuration"),
    ("run yaml/documents.yaml --no-trace", 1, "error"),
    ("run yaml/anchor.yaml --no-trace", 1, "yaml-syntax"),
    ("run yaml/self-base.yaml --no-trace", 1, "include-cycle"),
    ("run yaml/chain-0.yaml --no-trace", 1, "limit-exceeded"),
    ("run yaml/base-folder.yaml --no-trace", 1, "folder"),
    ("run yaml/base-pipe.yaml --no-trace", 1, "pipe or a device"),
    ("run yaml/base-device.yaml --no-trace", 1, "pipe or a device"),
    ("run yaml/base-secret.yaml --no-trace", 1, "error"),
    ("run yaml/rules-missing.yaml --no-trace", 1, "missing-file"),
    ("run yaml/rules-folder.yaml --no-trace", 1, "folder"),
    ("run yaml/rules-pipe.yaml --no-trace", 1, "pipe or a device"),
    ("run yaml/view-large.yaml --no-trace", 1, "invalid-value"),
    ("run yaml/view-negative.yaml --no-trace", 1, "invalid-value"),
    ("run yaml/view-nan.yaml --no-trace", 1, "invalid-value"),
    ("run yaml/ticks.yaml --no-trace", 1, "invalid-value"),
    ("run yaml/agents.yaml --no-trace", 1, "error"),
    ("run yaml/agents-none.yaml --no-trace", 0, "300 ticks"),
    ("run yaml/priority.yaml --no-trace", 1, "invalid-value"),
    ("run yaml/map-zero.yaml --no-trace", 1, "invalid"),
    ("run yaml/map-large.yaml --no-trace", 1, "invalid-value"),
    ("run yaml/map-narrow.yaml --no-trace", 1, "invalid"),
    ("run yaml/crlf.yaml --no-trace --ticks 1", 0, "1 tick"),
    ("run yaml/bom.yaml --no-trace --ticks 1", 0, "1 tick"),
    ("run easy --ticks 0 --no-trace", 2, "from 1 to 1000000000"),
    (
        "run easy --rules runaway.dl --no-trace --max-rows 10K",
        1,
        "raise the limit with `--max-rows`",
    ),
    (
        "run easy --rules runaway.dl --no-pictures --out new --max-steps 100K",
        1,
        "raise the limit with `--max-steps`",
    ),
    ("run easy --rules zero.dl --no-trace", 2, "it is a device"),
    ("run zero --no-trace", 2, "it is a device"),
    (
        "run yaml/crlf.yaml --ticks 1 --no-pictures --out new --html yaml/crlf.yaml --force",
        2,
        "this command reads it",
    ),
    ("run easy --ticks 1 --no-pictures --out -", 2, "several files"),
    (
        "run easy --ticks 1 --no-pictures --out new --html -",
        2,
        "standard output",
    ),
    ("run easy --ticks -1 --no-trace", 2, "-1"),
    ("run easy --ticks 1e3 --no-trace", 2, "1e3"),
    ("run easy --ticks '' --no-trace", 2, "--ticks"),
    ("run easy --ticks 99999999999999999999 --no-trace", 2, "--ticks"),
    ("run easy --seed NaN --no-trace", 2, "NaN"),
    ("run easy --seed -1 --no-trace", 2, "-1"),
    ("run easy --split nonsense --no-trace", 2, "nonsense"),
    ("run easy --split '' --no-trace", 2, "--split"),
    ("run easy --executor '' --no-trace", 2, "--executor"),
    ("run easy --threads -1 --no-trace", 2, "1024"),
    ("run easy --threads 1025 --no-trace", 2, "1024"),
    ("run easy --rules missing.dl --no-trace", 2, "missing.dl"),
    ("run easy --rules folder --no-trace", 2, "folder"),
    ("run easy --rules good.dl --no-trace", 1, "error"),
    ("run easy --html page.html --no-trace", 2, "cannot be used"),
    ("run easy --ticks 1 --no-pictures --out good.dl", 2, "good.dl"),
    ("run easy --ticks 1 --no-pictures --out /dev/full", 2, "/dev/full"),
    ("run easy --ticks 1 --no-pictures --out loop.dl", 2, "loop.dl"),
    ("run easy --ticks 1 --no-pictures --out ''", 2, "a value is required"),
    (
        "run easy --ticks 1 --no-pictures --out foreign",
        2,
        "foreign/trace.jsonl",
    ),
    ("run easy --ticks 1 --no-pictures --out linked", 2, "linked/trace.jsonl"),
    ("run easy --ticks 1 --no-pictures --out taken", 2, "not a regular file"),
    (
        "run easy --ticks 1 --no-pictures --out new --html folder",
        2,
        "not a regular file",
    ),
    (
        "run easy --ticks 1 --no-pictures --out new --html new/trace.jsonl",
        2,
        "already writes it",
    ),
    (
        "run easy --ticks 1 --no-pictures --out new --html good.dl",
        2,
        "--force",
    ),
    ("run easy --ticks 1 --out new --pack missing", 2, "missing"),
    ("run easy --ticks 1 --out new --pack good.dl", 2, "not a folder"),
    ("run easy --ticks 1 --out new --pack packs/pipe", 2, "pipe or a device"),
    (
        "run easy --ticks 1 --no-pictures --out new --pack packs/pipe",
        2,
        "cannot be used",
    ),
    (
        "run easy --ticks 1 --no-pictures --out new > /dev/full",
        2,
        "standard output",
    ),
];

const TRACES: &[Case] = &[
    ("explain", 2, "TRACE"),
    ("explain missing.jsonl --agent Car_1", 2, "missing.jsonl"),
    ("explain folder --agent Car_1", 2, "folder"),
    ("explain empty.dl --agent Car_1", 1, "empty"),
    ("explain picture.png --agent Car_1", 1, "not-text"),
    ("explain deep.json --agent Car_1", 1, "not the header"),
    ("explain nul.dl --agent Car_1", 1, "a rule file, not a trace"),
    ("explain huge-line.json --agent Car_1", 1, "is empty"),
    ("explain trace.jsonl", 2, "--agent"),
    ("explain trace.jsonl --agent ''", 2, "no agent"),
    ("explain trace.jsonl --agent \"$(printf '\\377')\"", 2, "UTF-8"),
    (
        "explain trace.jsonl --agent Car_1 --tick -1",
        2,
        "expected an integer from 0",
    ),
    ("explain trace.jsonl --agent Car_1 --tick 99", 2, "no tick 99"),
    (
        "explain trace.jsonl --agent Car_1 --tick 99999999999999999999",
        2,
        "--tick",
    ),
    ("explain trace.jsonl --agent Car_1 --why-not Nonsense", 2, "Nonsense"),
    (
        "explain trace.jsonl --agent Car_1 --config missing.yaml",
        2,
        "missing.yaml",
    ),
    ("explain trace.jsonl --agent Car_1 --config folder", 2, "it is a folder"),
    ("explain trace.jsonl --agent Car_1 --config hard", 1, "trace-mismatch"),
    ("explain trace.jsonl --agent Car_1 --rules missing.dl", 2, "missing.dl"),
    ("explain trace.jsonl --agent Car_1 --rules good.dl", 1, "error"),
    ("explain trace-header.jsonl --agent Car_1", 2, "no ticks"),
    ("explain trace-truncated.jsonl --agent Car_1", 1, "not a tick"),
    ("explain trace-keys.jsonl --agent Car_1", 1, "not the header"),
    ("explain trace-version.jsonl --agent Car_1", 1, "version 1"),
    ("explain trace-future.jsonl --agent Car_1", 1, "version 99"),
    ("explain trace-config.jsonl --agent Car_1", 1, "error"),
    ("explain trace-base.jsonl --agent Car_1", 1, "error"),
    ("explain trace-rules.jsonl --agent Car_1", 1, "error"),
    ("explain trace-include.jsonl --agent Car_1", 1, "missing-include"),
    (
        "explain trace-cycle.jsonl --agent Car_1",
        1,
        "in the rules of the trace",
    ),
    ("explain trace-no-rules.jsonl --agent Car_1", 1, "error"),
    ("explain trace-runaway.jsonl --agent Car_1", 1, "limit-exceeded"),
    ("explain trace-agents.jsonl --agent Car_1", 1, "twice"),
    ("explain trace-type.jsonl --agent Car_1", 1, "type of agent"),
    ("explain trace-cell.jsonl --agent Car_1", 1, "not on the map"),
    ("explain trace-cell-large.jsonl --agent Car_1", 1, "not a tick"),
    ("explain trace-heading.jsonl --agent Car_1", 1, "heading"),
    ("explain trace-action.jsonl --agent Car_1", 1, "action"),
    ("explain trace-derived.jsonl --agent Car_1", 1, "trace-mismatch"),
    (
        "explain trace-gap.jsonl --agent Car_1",
        1,
        "found tick 77 instead of tick 2",
    ),
    ("check --coverage trace-gap.jsonl", 1, "found tick 77 instead of tick 2"),
    ("induce trace-gap.jsonl", 1, "found tick 77 instead of tick 2"),
    ("explain trace.jsonl --agent Car_1 > /dev/full", 2, "standard output"),
    ("view", 2, "TRACE"),
    ("view missing.jsonl", 2, "missing.jsonl"),
    ("view folder -o new.html", 2, "folder"),
    ("view deep.json -o new.html", 1, "not the header"),
    ("view trace.jsonl -o trace.jsonl", 2, "this command reads it"),
    ("view trace.jsonl -o trace.jsonl --force", 2, "this command reads it"),
    ("view trace.jsonl -o - > /dev/full", 2, "standard output"),
    ("view zero.dl -o new.html", 2, "it is a device"),
    ("explain zero.dl --agent Car_1", 2, "it is a device"),
    ("view trace.jsonl -o good.dl", 2, "--force"),
    ("view trace.jsonl -o folder", 2, "not a regular file"),
    ("view trace.jsonl -o pipe", 2, "not a regular file"),
    ("view trace.jsonl -o /dev/full", 2, "No space left"),
    ("view trace.jsonl -o missing/new.html", 2, "no folder"),
    ("view trace.jsonl -o dangling.dl", 2, "no folder"),
    ("view trace.jsonl -o new.html --from 99", 2, "before tick 99"),
    ("view trace.jsonl -o new.html --from -1", 2, "-1"),
    ("view trace.jsonl -o new.html --ticks 0", 2, "--ticks"),
    ("view trace.jsonl -o new.html --from 99999999999999999999", 2, "--from"),
    ("view trace-header.jsonl -o new.html", 1, "no ticks"),
    ("view trace-gap.jsonl -o new.html", 1, "invalid-trace"),
    ("view trace-number.jsonl -o new.html", 1, "invalid-trace"),
    ("view trace-clauses.jsonl -o new.html", 1, "invalid-trace"),
    ("view trace-truncated.jsonl -o new.html", 1, "not a tick"),
    ("view trace-config.jsonl -o new.html", 1, "error"),
    ("view trace-base.jsonl -o new.html", 1, "error"),
    ("view trace.jsonl -o new.html --pack missing", 2, "missing"),
    ("view trace.jsonl -o new.html --difficulty 101", 2, "0 to 100"),
];

const TASKS: &[Case] = &[
    ("episodes", 2, "Usage"),
    ("episodes nonsense", 2, "nonsense"),
    ("episodes check missing.yaml", 2, "missing.yaml"),
    ("episodes check folder", 2, "it is a folder"),
    ("episodes check vap-easy", 1, "task"),
    ("episodes check episodes/missing.yaml", 1, "missing"),
    ("episodes check episodes/empty.yaml", 1, "empty.jsonl"),
    ("episodes check episodes/deep.yaml", 1, "invalid-episode"),
    ("episodes check episodes/nul.yaml", 1, "invalid-episode"),
    ("episodes check episodes/binary.yaml", 1, "not-text"),
    ("episodes check episodes/pipe.yaml", 1, "pipe or a device"),
    ("episodes check episodes/numbers.yaml", 1, "invalid-episode"),
    ("episodes show easy --episode 99999", 2, "no episode"),
    ("episodes show easy --episode -1", 2, "expected an integer from 0"),
    ("episodes show easy --split nonsense", 2, "nonsense"),
    ("episodes make easy --count 0 -o new.jsonl", 2, "--count"),
    ("episodes make easy --count -5 -o new.jsonl", 2, "-5"),
    ("episodes make easy --count 1e9 -o new.jsonl", 2, "1e9"),
    ("episodes make easy --seed -1 -o new.jsonl", 2, "-1"),
    ("episodes make easy", 2, "--output"),
    ("episodes make easy --count 1 -o good.dl", 2, "--force"),
    ("episodes make easy --count 1 -o folder", 2, "not a regular file"),
    ("episodes make easy --count 1 -o /dev/full", 2, "No space left"),
    ("episodes make easy --count 1 -o - > /dev/full", 2, "standard output"),
    ("episodes make vap-easy --count 1 -o new.jsonl", 1, "task"),
    ("episodes spread easy --sets 1", 2, "--sets"),
    ("episodes spread easy --sets NaN", 2, "NaN"),
    ("episodes spread easy --count 0", 2, "--count"),
    ("questions missing.yaml", 2, "missing.yaml"),
    ("questions folder", 2, "it is a folder"),
    ("questions --count 0", 2, "--count"),
    ("questions --count 99999999999", 2, "--count"),
    ("questions --shots -1", 2, "-1"),
    ("questions --shots 1", 2, "shots"),
    ("questions --about ''", 2, "concept"),
    ("questions --about nonsense", 2, "nonsense"),
    ("questions --mini --count 5", 2, "cannot be used"),
    ("questions --entities nonsense", 2, "nonsense"),
    ("questions --seed 1.5", 2, "1.5"),
    ("questions --count 8 --shots 0 -o good.dl", 2, "--force"),
    ("questions --count 8 --shots 0 --csv folder", 2, "not a regular file"),
    (
        "questions --count 8 --shots 0 -o new.x --csv new.x",
        2,
        "already writes it",
    ),
    (
        "questions --count 8 --shots 0 --csv -",
        2,
        "both write to standard output",
    ),
    (
        "questions --count 8 --shots 0 -o /dev/stdout --csv -",
        2,
        "both write to standard output",
    ),
    ("questions --count 8 --shots 0 > /dev/full", 2, "standard output"),
    ("questions --rules missing.dl", 2, "missing.dl"),
    ("route --from 1,1 --to a,b", 2, "a,b"),
    ("route --from 1 --to 2,2", 2, "--from"),
    ("route --type car --from -1,5 --to 2,2", 2, "[-1, 5] is not on the map"),
    (
        "route --type car --from -x --to 2,2",
        2,
        "row and column as two integers",
    ),
    ("route --from 99999999999,1 --to 2,2", 2, "--from"),
    ("route --from NaN,NaN --to 2,2", 2, "NaN"),
    ("route --map missing --type car --from 1,1 --to 2,2", 2, "missing"),
    ("route --map folder --type car --from 1,1 --to 2,2", 2, "it is a folder"),
    ("route --type nonsense --from 1,1 --to 2,2", 2, "nonsense"),
    ("route --type car --from 0,0 --to 2147483647,2147483647", 2, "no-route"),
];

const PICTURES: &[Case] = &[
    ("icons", 2, "Usage"),
    ("icons sheet --class ''", 2, "--class"),
    ("icons sheet --class nonsense", 2, "nonsense"),
    ("icons sheet --class \"$(printf '\\377')\"", 2, "UTF-8"),
    ("icons sheet --seed -1", 2, "-1"),
    ("icons sheet --difficulty -1", 2, "0 to 100"),
    ("icons sheet --difficulty NaN", 2, "0 to 100"),
    ("icons sheet --pack-mode replace", 2, "--pack"),
    ("icons sheet -o good.dl", 2, "--force"),
    ("icons sheet -o folder", 2, "not a regular file"),
    ("icons sheet -o /dev/full", 2, "No space left"),
    (
        "icons sheet -o packs/truncated/car/icon.png --pack packs/truncated --force",
        2,
        "this command reads it",
    ),
    ("icons sheet -o new.png --pack missing", 2, "no such folder"),
    ("icons sheet -o new.png --pack good.dl", 2, "not a folder"),
    ("icons sheet -o new.png --pack folder", 1, "folder"),
    ("icons sheet -o new.png --pack packs/pipe", 2, "pipe or a device"),
    ("icons sheet -o new.png --pack packs/class", 1, "nonsense"),
    ("icons sheet -o new.png --pack packs/empty", 1, "car/icon.png"),
    ("icons sheet -o new.png --pack packs/truncated", 1, "car/icon.png"),
    ("icons sheet -o new.png --pack packs/dimensions", 1, "car/icon.png"),
    ("icons sheet -o new.png --pack packs/text", 1, "car/icon.png"),
    ("icons sheet -o new.png --pack packs/gif", 1, "car/icon.gif"),
    ("icons sheet -o new.png --pack packs/large", 1, "car/icon.png"),
    ("icons sheet -o new.png --pack packs/entities", 1, "car/icon.svg"),
    ("icons sheet -o new.png --pack packs/reference", 1, "car/icon.svg"),
    ("icons sheet -o new.png --pack packs/nested", 1, "car/icon.svg"),
    ("icons sheet -o new.png --pack packs/use", 1, "car/icon.svg"),
    ("icons sheet -o new.png --pack packs/size", 1, "car/icon.svg"),
    ("icons sheet -o new.png --pack packs/loop", 1, "loop"),
    ("vap", 2, "Usage"),
    ("vap make", 2, "--mode"),
    ("vap make --mode nonsense --split test --out new", 2, "nonsense"),
    ("vap make --mode easy --split nonsense --out new", 2, "nonsense"),
    ("vap make --mode easy --split test", 2, "--out"),
    ("vap make --mode easy --split test --out ''", 2, "a value is required"),
    ("vap make --mode easy --split test --out good.dl", 2, "good.dl"),
    ("vap make --mode easy --split test --out /dev/full", 2, "/dev/full"),
    (
        "vap make --mode easy --split test --out foreign",
        2,
        "foreign/manifest.json",
    ),
    ("vap make --mode easy --split test --out readme", 2, "readme/README.md"),
    ("vap make --mode easy --split test --out sets/world", 2, "world.json"),
    (
        "vap make --mode easy --split test --out sets/pipe",
        2,
        "not a regular file",
    ),
    ("vap make --mode easy --split test --worlds 0 --out new", 2, "--worlds"),
    (
        "vap make --mode easy --split test --worlds 99999999999 --out new",
        2,
        "--worlds",
    ),
    ("vap make --mode easy --split test --first-world -1 --out new", 2, "-1"),
    ("vap make --mode easy --split test --threads 5000 --out new", 2, "1024"),
    (
        "vap make --mode easy --split test --difficulty 1e2 --out new",
        2,
        "0 to 100",
    ),
    (
        "vap make --mode easy --split test --pack packs/text --out new",
        1,
        "car/icon.png",
    ),
    ("vap check missing", 2, "missing"),
    ("vap check good.dl", 2, "good.dl"),
    ("vap check folder", 2, "manifest.json"),
    ("vap check foreign", 1, "manifest.json"),
    ("vap check sets/deep", 1, "manifest.json"),
    ("vap check sets/binary", 2, "manifest.json"),
    ("vap check sets/pipe", 2, "pipe or a device"),
    ("vap check sets/version", 1, "version 99"),
    ("vap check sets/numbers", 1, "manifest.json"),
    ("vap check set-table", 1, "parquet"),
    ("vap check set-cut", 1, "parquet"),
    ("vap check set-extra", 1, "foreign.txt"),
    ("vap check set-missing", 1, "pairs.parquet"),
    ("vap check folder --threads -1", 2, "1024"),
];

const BENCH: &[Case] = &[
    ("bench nonsense", 2, "nonsense"),
    ("bench tick --config missing.yaml", 2, "missing.yaml"),
    ("bench tick --agents -1", 2, "-1"),
    ("bench tick --agents 999999999999", 2, "--agents"),
    ("bench tick --seconds -1", 2, "-1"),
    ("bench tick --seconds NaN", 2, "NaN"),
    ("bench tick --seconds inf", 2, "inf"),
    ("bench tick --seconds 1e308", 2, "1e308"),
    ("bench tick --seconds ''", 2, "--seconds"),
    ("bench tick --threads 1e9", 2, "1024"),
    ("bench tick --seed -1", 2, "-1"),
    ("bench tick --scenes deep.json", 2, "--scenes"),
    ("bench infer --scenes missing.jsonl", 2, "missing.jsonl"),
    ("bench infer --scenes folder", 2, "folder"),
    ("bench infer --scenes deep.json", 1, "invalid-scene"),
    ("bench infer --scenes empty.dl", 1, "scene"),
    ("bench infer --scenes picture.png", 1, "not-text"),
    ("completions nonsense", 2, "nonsense"),
    ("completions bash > /dev/full", 2, "standard output"),
];

const SERVER: &[Case] = &[
    ("printf '' | @ lsp", 2, "error"),
    ("lsp < empty.dl", 2, "error"),
    ("lsp < picture.png", 2, "malformed"),
    (
        "printf 'Content-Length: 99999999999999\\r\\n\\r\\n{}' | @ lsp",
        2,
        "at most 64 MiB",
    ),
    (
        "printf 'Content-Length: 18446744073709551616\\r\\n\\r\\n{}' | @ lsp",
        2,
        "at most 64 MiB",
    ),
    ("printf 'Content-Length: -5\\r\\n\\r\\n{}' | @ lsp", 2, "Content-Length"),
    (
        "printf 'Content-Length: NaN\\r\\n\\r\\n{}' | @ lsp",
        2,
        "Content-Length",
    ),
    (
        "printf 'Content-Length: 60000000\\r\\n\\r\\n{}' | @ lsp",
        2,
        "ends within",
    ),
    ("printf 'Content-Length: 2\\n\\n{}' | @ lsp", 2, "malformed"),
    ("printf 'Nonsense\\r\\n\\r\\n{}' | @ lsp", 2, "malformed"),
    ("printf 'Content-Type: x\\r\\n\\r\\n{}' | @ lsp", 2, "no Content-Length"),
    ("printf 'Content-Length: 0\\r\\n\\r\\n' | @ lsp", 2, "not a message"),
    ("printf 'Content-Length: 2\\r\\n\\r\\n{}' | @ lsp", 2, "error"),
    (
        "printf 'Content-Length: 3\\r\\n\\r\\n\\377\\377\\377' | @ lsp",
        2,
        "not a message",
    ),
    ("head -c 50000000 /dev/zero | @ lsp", 2, "malformed"),
    (
        "(printf 'Content-Length: 1000000\\r\\n\\r\\n'; head -c 1000000 deep.json) | @ lsp",
        2,
        "not a message",
    ),
    ("lsp < lsp/twice", 0, "capabilities"),
    ("lsp < lsp/unknown", 0, "unknown"),
    ("lsp < lsp/positions", 0, "capabilities"),
    ("lsp < lsp/texts", 0, "diagnostics"),
    ("lsp < lsp/parameters", 0, "error"),
    ("lsp < lsp/include", 0, "missing-include"),
    ("lsp < lsp/initialize > /dev/full", 2, "error"),
    ("lsp --socket 1", 2, "--socket"),
];

const INDUCE: &[Case] = &[
    ("induce missing.jsonl", 2, "missing.jsonl"),
    ("induce ''", 2, "a value is required"),
    ("induce empty.dl", 1, "no examples"),
    ("induce - < empty.dl", 1, "no examples"),
    ("induce folder", 2, "manifest.json"),
    ("induce foreign", 1, "manifest.json"),
    ("induce sets/deep", 1, "manifest.json"),
    ("induce set-table --config vap-easy", 1, "parquet"),
    ("induce set-missing --config vap-easy", 1, "pairs.parquet"),
    ("induce picture.png", 1, "not-text"),
    ("induce latin1.dl", 1, "not-text"),
    ("induce nul.dl", 1, "invalid-scene"),
    ("induce deep.json", 1, "invalid-scene"),
    ("induce huge-line.json", 1, "limit-exceeded"),
    ("induce zero.dl", 2, "it is a device"),
    ("induce loop.dl", 2, "loop.dl"),
    ("induce trace-header.jsonl --config easy", 1, "no examples"),
    ("induce trace-truncated.jsonl --config easy", 1, "not a tick"),
    ("induce trace-future.jsonl --config easy", 1, "version 99"),
    ("induce trace-action.jsonl --config easy", 1, "action"),
    ("induce trace-cell.jsonl --config easy", 1, "not on the map"),
    ("induce trace-runaway.jsonl --config easy", 1, "--max-rows"),
    ("induce trace.jsonl --config easy --rules good.dl", 1, "error"),
    ("induce trace.jsonl --config missing.yaml", 2, "missing.yaml"),
    ("induce trace.jsonl --config folder", 2, "it is a folder"),
    ("induce trace.jsonl --config easy --rules zero.dl", 2, "it is a device"),
    ("induce scenes/labeled.jsonl", 0, "IsBus"),
    ("induce - < scenes/labeled.jsonl", 0, "IsBus"),
    ("cat scenes/labeled.jsonl | @ induce /dev/stdin", 0, "IsBus"),
    ("induce scenes/unlabeled.jsonl", 1, "has no actions"),
    ("induce scenes/contradiction.jsonl", 1, "contradicting-examples"),
    ("induce scenes/contradiction.jsonl --noise 0.4", 0, "Noise: 40.00 %"),
    ("induce scenes/one-action.jsonl", 0, "No clause: 0 examples"),
    ("induce scenes/default.jsonl", 0, "No clause: 0 examples"),
    ("induce scenes/action.jsonl", 1, "Fly"),
    ("induce scenes/unknown-name.jsonl", 1, "invalid-scene"),
    ("induce scenes/crowd.jsonl", 1, "the limit is 64"),
    ("induce scenes/cut.jsonl", 1, "invalid-scene"),
    ("induce scenes/labeled.jsonl --test missing.jsonl", 2, "missing.jsonl"),
    ("induce scenes/labeled.jsonl --test empty.dl", 1, "no examples"),
    ("induce scenes/labeled.jsonl > /dev/full", 2, "standard output"),
    ("induce scenes/labeled.jsonl -o /dev/full", 2, "No space left"),
    (
        "induce scenes/labeled.jsonl -o new.dl --report /dev/full",
        2,
        "No space left",
    ),
    ("induce scenes/labeled.jsonl -o - --report -", 2, "would both write"),
    ("induce scenes/labeled.jsonl -o folder", 2, "not a regular file"),
    ("induce scenes/labeled.jsonl -o pipe", 2, "not a regular file"),
    ("induce scenes/labeled.jsonl -o missing/new.dl", 2, "no folder"),
    ("induce scenes/labeled.jsonl -o good.dl", 2, "--force"),
    (
        "induce scenes/labeled.jsonl -o scenes/labeled.jsonl --force",
        2,
        "this command reads it",
    ),
    (
        "induce scenes/labeled.jsonl --rules city.dl -o linked-city.dl --force",
        2,
        "this command reads it",
    ),
    (
        "induce scenes/labeled.jsonl --test ego.json -o new.dl --report ego.json --force",
        2,
        "this command reads it",
    ),
    ("induce -o new.dl --page new.html", 2, "--page needs one trace"),
    (
        "induce scenes/labeled.jsonl -o new.dl --page new.html",
        2,
        "is not a trace",
    ),
    (
        "induce trace.jsonl --config easy --page new.html",
        2,
        "--page needs one trace",
    ),
    (
        "induce trace.jsonl --config easy -o new.dl --page trace.jsonl --force",
        2,
        "this command reads it",
    ),
    ("induce scenes/labeled.jsonl --variables 1", 2, "from 2 to 7"),
    ("induce scenes/labeled.jsonl --variables 8", 2, "from 2 to 7"),
    ("induce scenes/labeled.jsonl --variables NaN", 2, "from 2 to 7"),
    ("induce scenes/labeled.jsonl --effort 0", 2, "from 1 to 4294967295"),
    (
        "induce scenes/labeled.jsonl --effort 4294967296",
        2,
        "from 1 to 4294967295",
    ),
    ("induce scenes/labeled.jsonl --effort 1", 0, "IsBus"),
    ("induce scenes/labeled.jsonl --noise -1", 2, "from 0 to 0.4"),
    ("induce scenes/labeled.jsonl --noise 0.41", 2, "from 0 to 0.4"),
    ("induce scenes/labeled.jsonl --noise NaN", 2, "from 0 to 0.4"),
    ("induce scenes/labeled.jsonl --noise auto", 0, "Noise: 33.33 %"),
    ("induce scenes/labeled.jsonl --threads 0", 0, "IsBus"),
    ("induce scenes/labeled.jsonl --threads 99999999999", 2, "from 0 to 1024"),
    ("induce scenes/labeled.jsonl --seed -1", 2, "--seed"),
    ("induce scenes/labeled.jsonl --order Fly", 2, "Fly"),
    ("induce scenes/labeled.jsonl --episodes 1", 2, "cannot be used with"),
    ("induce scenes/labeled.jsonl --split test", 2, "cannot be used with"),
    ("induce --config easy --episodes 0", 2, "--episodes"),
    ("induce --config easy --episodes 101", 2, "100 recorded episodes"),
];

const POPPER: &[Case] = &[
    ("induce --popper popper/good", 0, "f(X) :- p(X, Y), q(Y)."),
    (
        "induce --popper popper/good --closed-world --negation",
        0,
        "closed world",
    ),
    ("induce --popper popper/rules", 0, "f(X) :- r(X)."),
    (
        "induce --popper popper/good -o new.dl --report -",
        0,
        "\"target\": \"f/1\"",
    ),
    ("induce --popper ''", 2, "a value is required"),
    ("induce --popper missing", 2, "missing/bk.pl"),
    ("induce --popper good.dl", 2, "`good.dl` is not a folder"),
    ("induce --popper folder", 2, "folder/bk.pl"),
    ("induce --popper popper/no-bias", 2, "popper/no-bias/bias.pl"),
    ("induce --popper popper/pipe", 2, "it is a pipe or a device"),
    ("induce --popper popper/device", 2, "it is a pipe or a device"),
    ("induce --popper popper/loop", 2, "popper/loop/bk.pl"),
    ("induce --popper popper/empty", 1, "names no predicate to learn"),
    ("induce --popper popper/latin1", 1, "not-text"),
    ("induce --popper popper/nul", 1, "bk.pl:1:1"),
    ("induce --popper popper/picture", 1, "not-text"),
    ("induce --popper popper/deep", 1, "nested more than 100 levels"),
    ("induce --popper popper/deep-open", 1, "nested more than 100 levels"),
    ("induce --popper popper/brackets", 1, "a list is not supported"),
    ("induce --popper popper/comment", 1, "never closed"),
    ("induce --popper popper/quote", 1, "never closed"),
    ("induce --popper popper/function", 1, "bk.pl:1:3"),
    ("induce --popper popper/arithmetic", 1, "arithmetic is not supported"),
    (
        "induce --popper popper/recursion",
        1,
        "recursive clauses are not supported",
    ),
    ("induce --popper popper/recursive-rules", 0, "r(X, Y)"),
    ("induce --popper popper/cycle", 1, "cyclic-negation"),
    ("induce --popper popper/unbound", 1, "unbound-variable"),
    ("induce --popper popper/unknown", 1, "unknown-predicate"),
    ("induce --popper popper/arity", 1, "is not supported"),
    ("induce --popper popper/targets", 1, "a second target"),
    ("induce --popper popper/numbers", 1, "not a number up to 1000"),
    ("induce --popper popper/both", 1, "positive and negative"),
    ("induce --popper popper/positive", 1, "--closed-world"),
    ("induce --popper popper/unlabeled", 1, "expected an example"),
    (
        "induce --popper popper/same",
        1,
        "separates 1 positive example from the negative examples",
    ),
    ("induce --popper popper/faults", 1, "and 996 more places"),
    ("induce --popper popper/name", 0, "derive 1 of 1 positive"),
    ("induce --popper popper/links", 0, "1 of 1 positive"),
    ("induce --popper popper/product", 1, "--max-rows"),
    ("induce --popper popper/product --max-rows 10K", 1, "--max-rows"),
    ("induce --popper popper/product --max-memory 1M", 1, "--max-memory"),
    ("induce --popper popper/product --max-steps 10K", 1, "--max-steps"),
    ("induce --popper popper/facts -o new.dl", 0, "1 of 1 positive"),
    (
        "induce --popper popper/domain --closed-world",
        1,
        "more than 10000 examples",
    ),
    ("induce --popper popper/examples --variables 3", 1, "0 of 1000 positive"),
    ("induce --popper popper/good --variables 8", 2, "from 2 to 7"),
    ("induce --popper popper/good --effort 0", 2, "from 1 to 4294967295"),
    ("induce --popper popper/good --config easy", 2, "cannot be used with"),
    (
        "induce --popper popper/good scenes/labeled.jsonl",
        2,
        "cannot be used with",
    ),
    ("induce --popper popper/good --test ego.json", 2, "cannot be used with"),
    (
        "induce --popper popper/good --page new.html -o new.dl",
        2,
        "cannot be used with",
    ),
    ("induce --popper popper/good --noise auto", 0, "seed 0, noise."),
    ("induce --popper popper/good --order Stop", 2, "cannot be used with"),
    ("induce --popper popper/good --episodes 1", 2, "cannot be used with"),
    (
        "induce --popper popper/good --popper popper/good",
        2,
        "cannot be used multiple times",
    ),
    ("induce --closed-world", 2, "--popper <FOLDER>"),
    ("induce --negation", 2, "--popper <FOLDER>"),
    ("induce --popper popper/good > /dev/full", 2, "standard output"),
    ("induce --popper popper/good -o /dev/full", 2, "No space left"),
    ("induce --popper popper/good -o folder", 2, "not a regular file"),
    ("induce --popper popper/good -o good.dl", 2, "--force"),
    ("induce --popper popper/good -o - --report -", 2, "would both write"),
    (
        "induce --popper popper/good -o popper/good/bk.pl --force",
        2,
        "this command reads it",
    ),
    (
        "induce --popper popper/good -o new.pl --report popper/good/exs.pl --force",
        2,
        "this command reads it",
    ),
];

const ASK: &[Case] = &[
    ("induce --config easy --episodes 0", 2, "--ask"),
    ("induce --config easy --episodes 0 --ask", 2, "a value is required"),
    ("induce --config easy --episodes 0 --ask ''", 2, "a value is required"),
    ("induce --config easy --episodes 0 --ask missing.dl", 2, "missing.dl"),
    ("induce --config easy --episodes 0 --ask folder/x.dl", 2, "x.dl"),
    ("induce --config easy --episodes 0 --ask latin1.dl", 1, "not-text"),
    ("induce --config easy --episodes 0 --ask nul.dl", 1, "nul.dl"),
    ("induce --config easy --episodes 0 --ask good.dl", 1, "rule-mismatch"),
    ("induce --config easy --episodes 0 --ask loop.dl", 2, "loop.dl"),
    ("induce --config easy --episodes 0 --ask zero.dl", 2, "it is a device"),
    (
        "induce --config easy --episodes 0 --ask deep-parentheses.dl",
        1,
        "limit-exceeded",
    ),
    (
        "induce --config easy --episodes 0 --ask \"$(printf 'x\\377')\"",
        2,
        "UTF-8",
    ),
    (
        "induce --config easy --episodes 0 --ask missing-program",
        2,
        "exit status: 127",
    ),
    (
        "induce --config easy --episodes 0 --ask true",
        2,
        "ended without an answer",
    ),
    ("induce --config easy --episodes 0 --ask 'kill -9 $$'", 2, "SIGKILL"),
    ("induce --config easy --episodes 0 --ask cat", 1, "not an action"),
    ("induce --config easy --episodes 0 --ask yes", 1, "invalid-answer"),
    (
        "induce --config easy --episodes 0 --ask 'cat /dev/zero'",
        1,
        "invalid-answer",
    ),
    (
        "induce --config easy --episodes 0 --ask 'cat deep.json'",
        1,
        "invalid-answer",
    ),
    (
        "induce --config easy --episodes 0 --ask 'cat picture.png'",
        1,
        "invalid-answer",
    ),
    (
        "induce --config easy --episodes 0 --ask 'cat < /dev/full'",
        1,
        "invalid-answer",
    ),
    (
        "induce --config easy --episodes 0 --ask 'sleep 60' --answer-timeout 0.2",
        2,
        "no answer in 0.2 s",
    ),
    (
        "induce --config easy --episodes 0 --ask 'exec <&- >&-; sleep 60'",
        2,
        "closed its output",
    ),
    ("induce --config easy --ask rules/easy.dl --questions -1", 2, "-1"),
    ("induce --config easy --ask rules/easy.dl --questions 1e9", 2, "1e9"),
    ("induce --config easy --ask rules/easy.dl --agreements NaN", 2, "NaN"),
    (
        "induce --config easy --ask rules/easy.dl --answer-timeout NaN",
        2,
        "from 0.001",
    ),
    (
        "induce --config easy --ask rules/easy.dl --answer-timeout 0",
        2,
        "from 0.001",
    ),
    (
        "induce --config easy --ask rules/easy.dl --answer-timeout 1e300",
        2,
        "from 0.001",
    ),
    (
        "induce --config easy --ask rules/easy.dl --sweep 3",
        2,
        "expected numbers",
    ),
    (
        "induce --config easy --ask rules/easy.dl --sweep 3,64",
        2,
        "from 1 to 5",
    ),
    (
        "induce --config easy --ask rules/easy.dl --sweep -1,2",
        2,
        "unexpected argument",
    ),
    (
        "induce --config easy --ask rules/easy.dl --sweep 99999999999999999999,2",
        2,
        "expected numbers",
    ),
    (
        "induce --config easy --episodes 0 --ask rules/easy.dl --sweep 1000,5 --questions 3",
        0,
        "limit of questions",
    ),
    (
        "induce --config easy --ask rules/easy.dl --noise 0.1",
        2,
        "cannot be used",
    ),
    ("induce --config easy --log new.jsonl", 2, "--ask"),
    (
        "induce --config easy --episodes 0 --ask true --log folder",
        2,
        "not a regular file",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log /dev/full",
        2,
        "not a regular file",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log /dev/zero",
        2,
        "not a regular file",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log loop.dl",
        2,
        "loop.dl",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log missing/new.jsonl",
        2,
        "missing/new.jsonl",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log -",
        2,
        "--log needs a file",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log good.dl",
        2,
        "not a log of questions",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log latin1.dl",
        2,
        "not a log of questions",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log nul.dl",
        2,
        "not a log of questions",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log picture.png",
        2,
        "not a log of questions",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log deep.json",
        2,
        "not a log of questions",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log huge-line.json",
        2,
        "its last line is longer than 64 MiB",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log trace.jsonl",
        2,
        "not a log of questions",
    ),
    (
        "induce trace.jsonl --config easy --ask true --log trace.jsonl",
        2,
        "this command reads it",
    ),
    (
        "induce --config easy --episodes 0 --ask true -o new.x --log new.x",
        2,
        "another output",
    ),
    (
        "induce --config easy --episodes 0 --ask true --log new.x --report new.x",
        2,
        "another output",
    ),
    (
        "induce --config easy --episodes 0 --ask cat > /dev/full",
        2,
        "standard output",
    ),
];

const ALL: [&[Case]; 16] = [
    CHECK, FORMAT, DIFF, SHORTCUTS, QUERY, REPL, INFER, RUN, TRACES, TASKS, PICTURES, BENCH, SERVER, INDUCE, POPPER,
    ASK,
];

/// The fixtures, written once and copied for each thread.
struct Fixtures {
    folder: tempfile::TempDir,
}

impl Fixtures {
    fn new() -> Fixtures {
        let fixtures = Fixtures {
            folder: tempfile::tempdir().unwrap(),
        };
        fixtures.rules();
        fixtures.facts();
        fixtures.configurations();
        fixtures.traces();
        fixtures.episodes();
        fixtures.packs();
        fixtures.sets();
        fixtures.messages();
        fixtures.scenes();
        fixtures.popper();
        fixtures
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn put(&self, name: &str, bytes: impl AsRef<[u8]>) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }

    fn link(&self, name: &str, target: &str) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        symlink(target, path).unwrap();
    }

    fn pipe(&self, name: &str) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
    }

    fn rules(&self) {
        let decl = ".decl A(x: number)\n.output A\n";
        fs::create_dir(self.path("folder")).unwrap();
        self.pipe("pipe");
        self.link("loop.dl", "loop.dl");
        self.link("dangling.dl", "nowhere/nothing.dl");
        self.link("zero.dl", "/dev/zero");
        self.link("zero", "/dev/zero");
        self.link("linked-city.dl", "city.dl");
        self.link("records/kernel/.logicity.json", "/proc/self/status");
        let outputs = (0..4000).map(|number| format!(".decl P{number}(x: number)\nP{number}(1).\n.output P{number}\n"));
        self.put("outputs.dl", outputs.collect::<String>());
        // Links give each of three files 25 names, so that they include each other in 15,625 ways.
        for (file, next) in [("first", "second"), ("second", "third"), ("third", "fourth")] {
            let includes = (0..25).map(|link| format!(".include \"l{link}/{next}.dl\"\n"));
            self.put(&format!("names/{file}.dl"), includes.collect::<String>());
        }
        self.put("names/fourth.dl", "");
        (0..25).for_each(|link| self.link(&format!("names/l{link}"), "."));
        let large = fs::File::create(self.path("large.dl")).unwrap();
        large.set_len(65 << 20).unwrap();
        let city = |rules: &str| format!(".include \"vocabulary.dl\"\n{rules}\n");
        self.put("city.dl", city("Stop(X) :- CollidingClose(X, Y)."));
        self.put("all.dl", city("Stop(X) :- IsCar(X), \u{2200}Y IsClose(X, Y)."));
        self.put("equation.dl", city("Stop(X) :- IsCar(X), Car_2 = Y."));
        self.put(
            "runaway.dl",
            city(".decl N(x: number)\nN(0).\nN(X + 1) :- N(X), X < 2000000000.\nStop(X) :- IsCar(X), N(1000000000)."),
        );
        self.put(
            "ego.json",
            "{\"entities\": [\"a\"], \"ego\": \"a\", \"facts\": {\"IsCar\": [\"a\"]}}\n",
        );
        self.put(
            "itself.dl",
            ".decl A(x: number)\nA(1).\n.output A(filename=\"itself.dl\")\n",
        );
        self.put(
            "rows.dl",
            ".decl A(x: number)\n.input A\n.output A(filename=\"A.facts\")\n",
        );
        self.put("good.dl", format!("{decl}A(1).\n"));
        self.put("latin1.dl", b"// caf\xe9\nA(1).\n");
        self.put(
            "utf16.dl",
            "A(1).".encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>(),
        );
        self.put("nul.dl", [0; 100]);
        self.put("empty.dl", "");
        self.put("comment.dl", "/* never closed");
        self.put("string.dl", format!("{decl}A(\"never closed).\n"));
        self.put("bom.dl", format!("\u{feff}{decl}A(1).\n"));
        self.put("crlf.dl", format!("{decl}A(1).\n").replace('\n', "\r\n"));
        self.put("picture.png", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\xff\xff\xff\xff");
        self.put("unformatted.dl", "  .decl   A(x:number)  \n");
        let deep = 200_000;
        self.put(
            "deep-parentheses.dl",
            format!("{decl}A(X) :- X = {}1{}.\n", "(".repeat(deep), ")".repeat(deep)),
        );
        self.put(
            "deep-aggregates.dl",
            format!("{decl}A(X) :- X = {}1", "count : { A(Y), Y = ".repeat(10_000)),
        );
        self.put("deep-negation.dl", format!("{decl}A(1) :- {}A(1).\n", "!".repeat(deep)));
        self.put("deep.json", "[".repeat(2_000_000));
        self.put("number.dl", format!("A({}).\n", "9".repeat(1_000_000)));
        self.put("float.dl", ".decl A(x: float)\nA(1e999).\nA(NaN).\n");
        let columns: Vec<String> = (0..100_000).map(|column| format!("c{column}: number")).collect();
        self.put("wide.dl", format!(".decl W({})\n", columns.join(", ")));
        let pairs = vec!["(A(X); A(X + 1))"; 60].join(", ");
        self.put("alternatives.dl", format!("{decl}A(X) :- {pairs}.\n"));
        self.put("faults.dl", "A(1\n".repeat(50_000));
        let variables: Vec<String> = (0..300).map(|variable| format!("A(X{variable})")).collect();
        self.put("variables.dl", format!("{decl}A(1) :- {}.\n", variables.join(", ")));
        self.put("names.dl", ".decl \u{1f697}(x: number)\n\u{1f697}(1).\n");
        self.put("negation.dl", format!("{decl}A(1) :- !A(1).\n"));
        let pattern = "(a{1000}){1000}".repeat(10);
        let matching = format!("P(\"{pattern}\").\nA(1) :- P(X), match(X, \"a\").\n");
        self.put("regex.dl", format!("{decl}.decl P(x: symbol)\n{matching}"));
        self.put("derived.dl", format!("{decl}A(1).\nA(X + 1) :- A(X), X < 5.\n"));
        self.put("include-self.dl", ".include \"include-self.dl\"\n");
        self.put("include-folder.dl", ".include \"folder\"\n");
        self.put("include-missing.dl", ".include \"missing.dl\"\n");
        for link in 0..80 {
            self.put(
                &format!("include-chain-{link}.dl"),
                format!(".include \"include-chain-{}.dl\"\n", link + 1),
            );
        }
        self.put(
            "include-up.dl",
            format!(".include \"{}missing.dl\"\n", "../".repeat(10_000)),
        );
        self.put("include-device.dl", ".include \"/dev/zero\"\n");
        self.put("include-pipe.dl", ".include \"pipe\"\n");
        self.put("include-passwd.dl", ".include \"/etc/passwd\"\n");
        self.put("input.dl", ".decl A(x: number)\n.input A\n.output A\n");
        self.put("text.dl", ".decl S(x: symbol)\n.input S\n.output S\n");
        self.put(
            "device.dl",
            ".decl A(x: number)\n.input A(filename=\"/dev/zero\")\n.output A\n",
        );
        self.put(
            "outside.dl",
            ".decl A(x: number)\nA(1).\n.output A(filename=\"../good.dl\")\n",
        );
        self.put(
            "endless.dl",
            format!("{decl}A(0).\nA(X + 1) :- A(X), X < 2000000000.\n"),
        );
        let grow = ".decl T(x: symbol)\n.output T\nT(\"aaaaaaaaaaaaaaaa\").\nT(cat(X, X)) :- T(X).\n";
        self.put("text-endless.dl", grow);
        let product = ".decl N(x: number)\nN(X) :- X = range(0, 1000).\n.decl A(x: number)\n.output A\n\
                       A(X) :- N(X), N(Y), N(Z), N(U), Y + Z + U < 0.\n";
        self.put("product.dl", product);
        self.put("range.dl", format!("{decl}A(X) :- X = range(0, 2000000000).\n"));
        let numbers = "A(1 / 0).\nA(-2147483648 / -1).\nA(5 % 0).\nA(2 ^ 99).\nA(1 bshl 99).\nA(2147483647 + 1).\n";
        self.put("arithmetic.dl", format!("{decl}{numbers}"));
        self.put(
            "substr.dl",
            format!("{decl}A(strlen(substr(\"aé\", -5, 2147483647))).\nA(to_number(\"9e99\")).\n"),
        );
        self.put("foreign/A.csv", "foreign\n");
        self.put("foreign/trace.jsonl", "foreign\n");
        self.put("foreign/manifest.json", "{\"foreign\": true}\n");
        self.put("readme/README.md", "# Mine\n");
        for name in ["A.csv", "trace.jsonl"] {
            self.link(&format!("linked/{name}"), "../good.dl");
            fs::create_dir_all(self.path(&format!("taken/{name}"))).unwrap();
        }
    }

    fn facts(&self) {
        self.put("facts/latin1/A.facts", b"1\n\xff\n");
        self.put("facts/nul/A.facts", [0; 10]);
        self.put("facts/wide/A.facts", "1\t".repeat(100_000));
        self.put("facts/large/A.facts", "99999999999999999999\n-99999999999999999999\n");
        self.put("facts/digits/A.facts", "7".repeat(1_000_000));
        self.put("facts/crlf/A.facts", "1\r\n2\r\n");
        self.put("facts/bom/A.facts", "\u{feff}1\n");
        self.put("facts/faults/A.facts", "x\n".repeat(50_000));
        fs::create_dir_all(self.path("facts/folder/A.facts")).unwrap();
        self.pipe("facts/pipe/A.facts");
        self.link("facts/loop/A.facts", "A.facts");
        self.put(
            "facts/gzip/A.facts",
            b"\x1f\x8b\x08\0\0\0\0\0\0\x03\x03\0\0\0\0\0\0\0\0\0",
        );
        self.put("facts/cut/A.facts", b"\x1f\x8b\x08\0\0\0\0\0\0\x03\x03");
        self.put("facts/text/S.facts", "\u{202e}\u{7}\u{1b}[31m\n".repeat(10));
        self.put("entities.json", {
            let mut scene = "{\"entities\":{".to_owned();
            for entity in 0..100_000 {
                write!(scene, "\"E{entity}\":{{\"type\":\"Car\"}},").unwrap();
            }
            scene + "\"Last\":{\"type\":\"Car\"}}}"
        });
        self.put("huge-line.json", vec![b' '; 70 << 20]);
    }

    fn configurations(&self) {
        let put = |name: &str, text: &str| self.put(&format!("yaml/{name}.yaml"), text);
        let easy = |name: &str, keys: &str| put(name, &format!("base: configs/easy.yaml\n{keys}\n"));
        let mut bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n".to_owned();
        for level in 1..12 {
            let parts = vec![format!("*a{}", level - 1); 10].join(", ");
            writeln!(bomb, "a{level}: &a{level} [{parts}]").unwrap();
        }
        put("bomb", &bomb);
        let deep: String = (0..3000).map(|level| format!("{}a:\n", " ".repeat(level))).collect();
        put("deep", &deep);
        put("deep-flow", &"[".repeat(1_000_000));
        put("large", &"# comment\n".repeat(1_000_000));
        put("tab", "rules:\n\t- x\n");
        put("duplicate", "base: configs/easy.yaml\nview: 5\nview: 6\n");
        put(
            "keys",
            &(0..30_000).map(|key| format!("k{key}: 1\n")).collect::<String>(),
        );
        put("list", "- 1\n- 2\n");
        put("documents", "--- 1\n--- 2\n--- 3\n");
        put("anchor", "a: *nothing\n");
        put("self-base", "base: self-base.yaml\n");
        for link in 0..20 {
            put(&format!("chain-{link}"), &format!("base: chain-{}.yaml\n", link + 1));
        }
        put("base-folder", "base: ../folder\n");
        put("base-pipe", "base: ../pipe\n");
        put("base-device", "base: /dev/zero\n");
        put("base-secret", "base: /etc/passwd\n");
        easy("rules-missing", "rules: missing.dl");
        easy("rules-folder", "rules: ../folder");
        easy("rules-pipe", "rules: ../pipe");
        easy("view-large", "view: 99999999999999999999");
        easy("view-negative", "view: -5");
        easy("view-nan", "view: .nan");
        easy("ticks", "ticks: 1e30");
        easy("agents", "agents: {test: {cars: [{count: 4000000000, priority: 1}]}}");
        easy("agents-none", "agents: {test: {}}");
        easy("priority", "agents: {test: {cars: [{priority: 99999999999}]}}");
        let map = |blocks: &str, widths: &str| {
            let buildings = "{random: {seed: 1, weights: {House: 1}}}";
            format!("map: {{blocks: {blocks}, widths: {widths}, buildings: {buildings}}}")
        };
        let usual = "{street: 8, sidewalk: 3, building: 6, inner_sidewalk: 1}";
        easy("map-zero", &map("[0, 0]", usual));
        easy("map-large", &map("[99999999, 99999999]", usual));
        easy(
            "map-narrow",
            &map("[2, 2]", "{street: 0, sidewalk: 0, building: 0, inner_sidewalk: 0}"),
        );
        put("crlf", "base: configs/easy.yaml\r\nview: 20\r\n");
        put("bom", "\u{feff}base: configs/easy.yaml\nview: 20\n");
    }

    fn run(&self, arguments: &[&str]) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_logicity"));
        let done = command
            .args(arguments)
            .current_dir(self.folder.path())
            .output()
            .unwrap();
        assert!(
            done.status.success(),
            "{arguments:?}: {}",
            String::from_utf8_lossy(&done.stderr)
        );
    }

    fn traces(&self) {
        self.run(&["run", "easy", "--ticks", "3", "--no-pictures", "--out", "made"]);
        let trace = fs::read_to_string(self.path("made/trace.jsonl")).unwrap();
        fs::remove_dir_all(self.path("made")).unwrap();
        self.put("trace.jsonl", &trace);
        let lines: Vec<&str> = trace.lines().collect();
        let parsed: Vec<serde_json::Value> = lines.iter().map(|line| serde_json::from_str(line).unwrap()).collect();
        self.put("trace-header.jsonl", lines[0]);
        self.put("trace-truncated.jsonl", &trace[..trace.len() - 100]);
        self.put("trace-keys.jsonl", "{\"trace\":\"logicity\",\"version\":2}\n");
        let change = |name: &str, line: usize, pointer: &str, value: &str| {
            let mut changed = parsed.clone();
            let value = serde_json::from_str(value).unwrap();
            let (parent, key) = pointer.rsplit_once('/').unwrap();
            match changed[line].pointer_mut(pointer) {
                Some(place) => *place = value,
                None => changed[line].pointer_mut(parent).unwrap()[key] = value,
            }
            let lines: Vec<String> = changed.iter().map(ToString::to_string).collect();
            self.put(&format!("trace-{name}.jsonl"), lines.join("\n"));
        };
        change("version", 0, "/version", "1");
        change("future", 0, "/version", "99");
        change("config", 0, "/configuration", "[[[]]]");
        change("base", 0, "/configuration/base", "\"/etc/passwd\"");
        change("no-rules", 0, "/rule_files", "[]");
        change("agents", 0, "/agents/1", &parsed[0]["agents"][0].to_string());
        change("type", 0, "/agents/0/type", "\"Bird\"");
        let rules = |name: &str, text: &str| {
            let mut changed = parsed.clone();
            let header = &mut changed[0];
            header["rule_files"] = serde_json::json!([{"name": header["rule_files"][0]["name"], "text": text}]);
            header["rules_hash"] = rules_hash(header).into();
            let lines: Vec<String> = changed.iter().map(ToString::to_string).collect();
            self.put(&format!("trace-{name}.jsonl"), lines.join("\n"));
        };
        rules("rules", "A(((");
        rules("include", ".include \"/etc/passwd\"");
        rules("cycle", &format!(".include {}", parsed[0]["rule_files"][0]["name"]));
        let vocabulary = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/rules/vocabulary.dl")).unwrap();
        let runaway =
            ".decl N(x: number)\nN(0).\nN(X + 1) :- N(X), X < 2000000000.\nStop(X) :- IsCar(X), N(1000000000).\n";
        rules("runaway", &format!("{vocabulary}\n{runaway}"));
        change("cell", 3, "/agents/0/at", "[-1, 5]");
        change("cell-large", 3, "/agents/0/at", "[1, 99999999999]");
        change("heading", 3, "/agents/0/heading", "\"Inwards\"");
        change("action", 3, "/agents/0/action", "\"Fly\"");
        change("derived", 3, "/agents/0/derived", "[\"Slow\",\"Fast\"]");
        change("gap", 3, "/tick", "77");
        change("number", 1, "/tick", "18446744073709551615");
        change("clauses", 1, "/agents/0/clauses", "[99999999999]");
    }

    fn episodes(&self) {
        let put = |name: &str, bytes: &[u8]| {
            let config = format!("base: configs/easy.yaml\ntask: {{episodes: {{test: {name}.jsonl}}}}\n");
            self.put(&format!("episodes/{name}.yaml"), config);
            self.put(&format!("episodes/{name}.jsonl"), bytes);
        };
        put("missing", b"");
        fs::remove_file(self.path("episodes/missing.jsonl")).unwrap();
        put("empty", b"");
        put("deep", "[".repeat(1_000_000).as_bytes());
        put("nul", &[0; 100]);
        put("binary", b"\xff\xfe");
        put("numbers", b"{\"seed\": 1e999, \"trips\": [[-1, 99999999999, 1, 1]]}\n");
        put("pipe", b"");
        fs::remove_file(self.path("episodes/pipe.jsonl")).unwrap();
        self.pipe("episodes/pipe.jsonl");
    }

    fn packs(&self) {
        let put = |pack: &str, name: &str, bytes: &[u8]| self.put(&format!("packs/{pack}/car/icon.{name}"), bytes);
        self.pipe("packs/pipe/car/icon.png");
        self.put("packs/class/nonsense/icon.png", "");
        put("empty", "png", b"");
        put("truncated", "png", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR");
        let mut dimensions = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".to_vec();
        dimensions.extend(b"\x7f\xff\xff\xff\x7f\xff\xff\xff\x08\x06\0\0\0\0\0\0\0");
        put("dimensions", "png", &dimensions);
        put("text", "png", b"no picture");
        put("gif", "gif", b"GIF89a");
        put("large", "png", &vec![0; 9 << 20]);
        let svg = |inner: &str| format!("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 9 9\">{inner}</svg>");
        let entities = "<!DOCTYPE svg [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;\">]>";
        put("entities", "svg", format!("{entities}{}", svg("&b;")).as_bytes());
        put(
            "reference",
            "svg",
            svg("<image href=\"/etc/passwd\" width=\"9\" height=\"9\"/>").as_bytes(),
        );
        put("nested", "svg", svg(&"<g>".repeat(100_000)).as_bytes());
        let mut uses = "<defs><rect id=\"u0\" width=\"1\" height=\"1\"/>".to_owned();
        for level in 1..30 {
            let used = format!("<use href=\"#u{}\"/>", level - 1).repeat(10);
            write!(uses, "<g id=\"u{level}\">{used}</g>").unwrap();
        }
        put(
            "use",
            "svg",
            svg(&format!("{uses}</defs><use href=\"#u29\"/>")).as_bytes(),
        );
        put(
            "size",
            "svg",
            b"<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"1e30\" height=\"1e-30\"/>",
        );
        self.link("packs/loop/car", "car");
    }

    fn sets(&self) {
        self.put("sets/deep/manifest.json", "[".repeat(1_000_000));
        self.put("sets/binary/manifest.json", b"\xff");
        self.pipe("sets/pipe/manifest.json");
        self.put(
            "sets/version/manifest.json",
            "{\"settings\":{\"data\":\"logicity vap\",\"version\":99}}",
        );
        self.put(
            "sets/numbers/manifest.json",
            "{\"settings\":{\"data\":\"logicity vap\",\"version\":2,\"seed\":1e999}}",
        );
        self.put("sets/world/world-00000/world.json", "{}");
        let make = [
            "vap",
            "make",
            "--mode",
            "easy",
            "--split",
            "test",
            "--worlds",
            "1",
            "--no-pictures",
        ];
        for set in ["set-table", "set-cut", "set-extra", "set-missing"] {
            if set == "set-table" {
                self.run(&[&make[..], &["--threads", "1", "--out", set]].concat());
            } else {
                copy(&self.path("set-table"), &self.path(set));
            }
        }
        let table = |set: &str| self.path(set).join("world-00000/entities.parquet");
        let bytes = fs::read(table("set-table")).unwrap();
        fs::write(table("set-cut"), &bytes[..bytes.len() / 2]).unwrap();
        self.put("set-extra/foreign.txt", "foreign");
        fs::remove_file(self.path("set-missing/world-00000/pairs.parquet")).unwrap();
        let mut changed = bytes;
        for byte in changed.iter_mut().skip(4).step_by(3) {
            *byte ^= 0x55;
        }
        fs::write(table("set-table"), changed).unwrap();
    }

    fn messages(&self) {
        let put = |name: &str, messages: &[&str]| {
            let begin = r#"{"jsonrpc":"2.0","id":1,"method":"initialize","params":{"capabilities":{}}}"#;
            let begun = r#"{"jsonrpc":"2.0","method":"initialized","params":{}}"#;
            let end = r#"{"jsonrpc":"2.0","id":99,"method":"shutdown"}"#;
            let exit = r#"{"jsonrpc":"2.0","method":"exit"}"#;
            let all = [&[begin, begun], messages, &[end, exit]].concat();
            let framed = all
                .iter()
                .map(|text| format!("Content-Length: {}\r\n\r\n{text}", text.len()));
            self.put(&format!("lsp/{name}"), framed.collect::<String>());
        };
        let open = |text: &str| {
            let text = serde_json::to_string(text).unwrap();
            format!(
                r#"{{"jsonrpc":"2.0","method":"textDocument/didOpen","params":{{"textDocument":{{"uri":"file:///x.dl","languageId":"x","version":1,"text":{text}}}}}}}"#
            )
        };
        put("initialize", &[]);
        put(
            "twice",
            &[r#"{"jsonrpc":"2.0","id":2,"method":"initialize","params":{"capabilities":{}}}"#],
        );
        put(
            "unknown",
            &[
                r#"{"jsonrpc":"2.0","id":2,"method":"unknown/method","params":[1,2,3]}"#,
                r#"{"jsonrpc":"2.0","method":"unknown/notification"}"#,
                r#"{"jsonrpc":"2.0","id":77,"result":null}"#,
                "[]",
                "{\"id\":",
            ],
        );
        let position = |line: &str| {
            format!(
                r#"{{"jsonrpc":"2.0","id":3,"method":"textDocument/hover","params":{{"textDocument":{{"uri":"file:///x.dl"}},"position":{{"line":{line},"character":{line}}}}}}}"#
            )
        };
        put(
            "positions",
            &[
                &open(".decl A(x: number)\nA(1).\n"),
                &position("4294967295"),
                &position("-1"),
                &position("99999999999999999999"),
            ],
        );
        put(
            "texts",
            &[
                &open("\u{0}\u{202e}\u{1f697}(((("),
                &open(&"(".repeat(200_000)),
                r#"{"jsonrpc":"2.0","method":"textDocument/didChange","params":{"textDocument":{"uri":"file:///never-opened.dl","version":-1},"contentChanges":[]}}"#,
                r#"{"jsonrpc":"2.0","method":"textDocument/didClose","params":{"textDocument":{"uri":"nonsense"}}}"#,
            ],
        );
        put(
            "parameters",
            &[
                r#"{"jsonrpc":"2.0","id":4,"method":"textDocument/rename","params":{"newName":1}}"#,
                r#"{"jsonrpc":"2.0","method":"textDocument/didOpen","params":"x"}"#,
            ],
        );
        put("include", &[&open(".include \"/dev/zero\"\n")]);
    }

    fn scenes(&self) {
        let scene = |entities: &str, facts: &str, actions: &str| {
            format!("{{\"entities\":[{entities}],\"ego\":\"a\",\"facts\":{{{facts}}},\"actions\":{{{actions}}}}}\n")
        };
        let two = |bus: &str, action: &str| {
            let facts = format!(r#""IsCar":["a","b"],"IsBus":[{bus}]"#);
            scene(r#""a","b""#, &facts, &format!("\"a\":\"{action}\""))
        };
        let put = |name: &str, text: String| self.put(&format!("scenes/{name}.jsonl"), text);
        let labeled = two("", "Normal") + &two("\"a\"", "Fast") + &two("\"b\"", "Normal");
        put("cut", labeled[..labeled.len() - 20].to_owned());
        put("contradiction", two("\"a\"", "Fast") + &labeled + &two("\"a\"", "Stop"));
        put("labeled", labeled);
        put("unlabeled", scene("\"a\"", "\"IsCar\":[\"a\"]", ""));
        put("one-action", two("", "Fast") + &two("\"a\"", "Fast"));
        put("default", two("", "Normal"));
        put("action", two("", "Fly"));
        put("unknown-name", scene("\"a\"", "\"IsCar\":[\"a\"]", "\"z\":\"Stop\""));
        let names: Vec<String> = (0..70).map(|index| format!("\"x{index}\"")).collect();
        let names = format!("\"a\",{}", names.join(","));
        put("crowd", scene(&names, "\"IsCar\":[\"a\"]", "\"a\":\"Stop\""));
    }

    fn popper(&self) {
        let put = |name: &str, texts: [&[u8]; 3]| {
            for (file, text) in ["bk.pl", "exs.pl", "bias.pl"].iter().zip(texts) {
                self.put(&format!("popper/{name}/{file}"), text);
            }
        };
        let (facts, examples) = ("p(a,b). q(b). p(c,d).", "pos(f(a)). neg(f(c)).");
        let bias = "head_pred(f,1). body_pred(p,2). body_pred(q,1). direction(p,(in,out)).";
        let background = |name: &str, text: &[u8]| put(name, [text, examples.as_bytes(), bias.as_bytes()]);
        let with = |name: &str, text: &str| background(name, format!("{facts} {text}").as_bytes());
        let labels = |name: &str, text: &str| put(name, [facts, text, bias].map(str::as_bytes));
        let biased = |name: &str, text: &str| put(name, [facts, examples, text].map(str::as_bytes));
        background("good", facts.as_bytes());
        for (name, target) in [("loop", "bk.pl"), ("device", "/dev/zero")] {
            background(name, b"");
            fs::remove_file(self.path(&format!("popper/{name}/bk.pl"))).unwrap();
            self.link(&format!("popper/{name}/bk.pl"), target);
        }
        background("pipe", b"");
        fs::remove_file(self.path("popper/pipe/bk.pl")).unwrap();
        self.pipe("popper/pipe/bk.pl");
        background("no-bias", facts.as_bytes());
        fs::remove_file(self.path("popper/no-bias/bias.pl")).unwrap();
        put("empty", [b"", b"", b""]);
        background("latin1", b"p(a,b). q('\xe9').");
        background("nul", &[0; 100]);
        background("picture", b"\x89PNG\r\n\x1a\n\0\0");
        background(
            "deep",
            format!("p({}a{}).", "g(".repeat(200_000), ")".repeat(200_000)).as_bytes(),
        );
        background("deep-open", "p((".repeat(200_000).as_bytes());
        background("brackets", "[".repeat(200_000).as_bytes());
        background("comment", format!("{facts} /* {}", "x".repeat(200_000)).as_bytes());
        background("quote", format!("p(a,'{}", "''".repeat(100_000)).as_bytes());
        background("function", b"p(s(A),b). q(b).");
        with("arithmetic", "q(N) :- p(_, M), N is M + 1.");
        biased("recursion", &format!("{bias} enable_recursion. body_pred(f,1)."));
        let reach = "r(X,Y) :- p(X,Y). r(X,Z) :- r(X,Y), p(Y,Z).";
        let reached = format!("{facts} p(b,e). s(e). {reach}");
        let wanted = "head_pred(f,1). body_pred(r,2). body_pred(s,1).";
        put("recursive-rules", [&reached, examples, wanted].map(str::as_bytes));
        let rules = format!("{facts} r(X) :- p(X,Y), q(Y).");
        put(
            "rules",
            [&rules, examples, "head_pred(f,1). body_pred(r,1)."].map(str::as_bytes),
        );
        with("cycle", "q(X) :- p(X,_), \\+ q(X).");
        with("unbound", "p(X,Y) :- q(X).");
        with("unknown", "q(X) :- nothing(X).");
        biased("arity", "head_pred(f,1). body_pred(p,9).");
        biased("targets", "head_pred(f,1). head_pred(g,1).");
        biased("numbers", "head_pred(f,99999999999999999999).");
        labels("both", "pos(f(a)). neg(f(a)). neg(f(c)).");
        labels("positive", "pos(f(a)).");
        labels("unlabeled", "f(a). pos(a). neg(f(a,b)).");
        labels("same", "pos(f(x)). neg(f(y)).");
        background("faults", "p(a,b.\n".repeat(1_000).as_bytes());
        with("name", &format!("q({}).", "x".repeat(1_000_000)));
        let many: String = (0..1_000).map(|index| format!("p(a,x{index}). ")).collect();
        with("links", &many);
        let numbers: String = (0..1_000).map(|index| format!("n({index}). ")).collect();
        let product = "w(A,B,C) :- n(A), n(B), n(C).";
        with("product", &format!("{numbers} {product}"));
        let large: String = (0..100_000).map(|index| format!("p(x{index},y{index}).\n")).collect();
        with("facts", &large);
        put(
            "domain",
            [
                many.as_bytes(),
                b"pos(f(a,x1)).",
                b"head_pred(f,2). body_pred(p,2). direction(p,(in,out)).",
            ],
        );
        let hub: String = (0..60).map(|index| format!("p(h,x{index}). ")).collect();
        let hubs: String = (0..2_000).map(|index| format!("p(a{index},h). ")).collect();
        let labels: String = (0..2_000)
            .map(|index| format!("{}(f(a{index})). ", ["pos", "neg"][index % 2]))
            .collect();
        put(
            "examples",
            [
                format!("{hub} {hubs} q(h).").as_bytes(),
                labels.as_bytes(),
                bias.as_bytes(),
            ],
        );
    }
}

/// Copies a folder with its links and pipes.
fn copy(from: &Path, to: &Path) {
    let copied = Command::new("cp").arg("-a").arg(from).arg(to).status().unwrap();
    assert!(copied.success());
}

/// The properties of a file that must not change.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Content {
    mode: u32,
    /// The hash of a regular file, or the target of a link.
    content: String,
}

/// Returns the content of all files and folders below a folder.
fn snapshot(folder: &Path) -> BTreeMap<PathBuf, Content> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(path) = open.pop() {
        for entry in fs::read_dir(path).unwrap() {
            let path = entry.unwrap().path();
            let metadata = fs::symlink_metadata(&path).unwrap();
            let content = if metadata.is_file() {
                // Large files are not rewritten with the same length by accident.
                match metadata.len() {
                    0..100_000 => format!("{:x}", Sha256::digest(fs::read(&path).unwrap())),
                    length => format!("{length} {:?}", metadata.modified().unwrap()),
                }
            } else if metadata.is_symlink() {
                fs::read_link(&path).unwrap().to_string_lossy().into_owned()
            } else {
                String::new()
            };
            let mode = metadata.permissions().mode();
            if metadata.is_dir() {
                open.push(path.clone());
            }
            found.insert(path, Content { mode, content });
        }
    }
    found
}

/// Runs a command line in `folder`. Returns its status, and what it printed, or that it did not end in time.
fn run(folder: &Path, output: &Path, line: &str) -> Result<(ExitStatus, String), String> {
    let line = match line.contains('@') {
        true => line.replace('@', "\"$0\""),
        false => format!("\"$0\" {line}"),
    };
    // In a separate group, so that all of a pipeline can be killed.
    let file = fs::File::create(output).unwrap();
    let mut process = Command::new("sh")
        .arg("-c")
        .arg(format!("ulimit -v {MEMORY}; ulimit -c 0; {line}"))
        .arg(env!("CARGO_BIN_EXE_logicity"))
        .process_group(0)
        .current_dir(folder)
        .env("XDG_STATE_HOME", folder)
        .env("RUST_BACKTRACE", "0")
        .stdin(Stdio::null())
        .stdout(file.try_clone().unwrap())
        .stderr(file)
        .spawn()
        .unwrap();
    let begun = Instant::now();
    let status = loop {
        if let Some(status) = process.try_wait().unwrap() {
            break status;
        }
        if begun.elapsed() > TIME {
            let group = format!("-{}", process.id());
            let _ = Command::new("kill").args(["-9", "--", &group]).status();
            process.wait().unwrap();
            return Err(format!("it has not ended after {} s", TIME.as_secs()));
        }
        thread::sleep(Duration::from_millis(2));
    };
    Ok((status, String::from_utf8_lossy(&fs::read(output).unwrap()).into_owned()))
}

/// Returns why a case fails.
fn fault((line, code, words): &Case, folder: &Path, output: &Path) -> Option<String> {
    let (status, said) = match run(folder, output, line) {
        Ok(done) => done,
        Err(fault) => return Some(fault),
    };
    let shown: String = said.chars().take(600).collect();
    if said.contains("panicked") || said.contains("overflowed its stack") || said.contains("memory allocation") {
        return Some(format!("it panicked or aborted: {shown}"));
    }
    if status.signal().is_some() || status.code() != Some(*code) {
        return Some(format!("{status} instead of exit code {code}: {shown}"));
    }
    if !said.contains(words) {
        return Some(format!("`{words}` is missing: {shown}"));
    }
    None
}

#[test]
fn slow_hostile_input_ends_with_a_message_and_harms_no_file() {
    let fixtures = Fixtures::new();
    let only = std::env::var("LOGICITY_HOSTILE").unwrap_or_default();
    let cases: Vec<&Case> = ALL
        .into_iter()
        .flatten()
        .filter(|(line, ..)| line.contains(&only))
        .collect();
    let (next, faults) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(|| {
                let own = tempfile::tempdir().unwrap();
                let (folder, output) = (own.path().join("here"), own.path().join("output"));
                copy(fixtures.folder.path(), &folder);
                let before = snapshot(&folder);
                while let Some(case) = cases.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let begun = Instant::now();
                    let mut fault = fault(case, &folder, &output);
                    let after = snapshot(&folder);
                    for (path, content) in &before {
                        if after.get(path) != Some(content) {
                            fault = Some(format!("{} changed: {:?}", path.display(), after.get(path)));
                        }
                    }
                    for path in after.keys().filter(|path| !before.contains_key(*path)).rev() {
                        let is_folder = fs::symlink_metadata(path).unwrap().is_dir();
                        if is_folder {
                            fs::remove_dir(path)
                        } else {
                            fs::remove_file(path)
                        }
                        .unwrap();
                    }
                    let time = begun.elapsed();
                    if time > Duration::from_secs(3) {
                        println!("{time:?}: {}", case.0);
                    }
                    if let Some(fault) = fault {
                        faults.lock().unwrap().push(format!("{}\n    {fault}", case.0));
                    }
                }
            });
        }
    });
    println!("{} cases", cases.len());
    let faults = faults.into_inner().unwrap();
    assert!(faults.is_empty(), "{} faults:\n{}", faults.len(), faults.join("\n"));
    assert!(!only.is_empty() || cases.len() >= 200);
}
