#![no_main]

#[path = "../../any_input/mod.rs"]
mod any_input;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| any_input::evaluate(bytes));
