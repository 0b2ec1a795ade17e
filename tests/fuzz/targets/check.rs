#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    logicity_fuzz::datalog::check(bytes);
    logicity_fuzz::city::conflicts(bytes);
});
