#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| logicity_fuzz::city::popper(bytes));
