#![no_main]

#[path = "../../tests/daemon/targets/states.rs"]
mod target;

libfuzzer_sys::fuzz_target!(|data: &[u8]| target::check(data));
