//! The exports of the module.

use std::cell::RefCell;
use std::panic;

use crate::engine::Engine;

#[derive(Default)]
struct Module {
    engine: Engine,
    input: Vec<u8>,
    output: Vec<u8>,
    column: Vec<f64>,
    ids: Vec<u32>,
}

thread_local! {
    static MODULE: RefCell<Module> = RefCell::default();
    /// The text of a panic, apart from what the request that panics has borrowed.
    static PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

fn with<T>(action: impl FnOnce(&mut Module) -> T) -> T {
    MODULE.with_borrow_mut(action)
}

/// Returns the address of a buffer for a request of `length` bytes.
#[unsafe(no_mangle)]
#[expect(unsafe_code, reason = "an export")]
extern "C" fn input(length: usize) -> *mut u8 {
    with(|module| {
        module.input = vec![0; length];
        module.input.as_mut_ptr()
    })
}

/// Executes the request in the buffer.
#[unsafe(no_mangle)]
#[expect(unsafe_code, reason = "an export")]
extern "C" fn request() {
    panic::set_hook(Box::new(|panic| PANIC.set(panic.to_string())));
    with(|module| {
        let reply = module
            .engine
            .request(&String::from_utf8_lossy(&module.input));
        module.output = reply.into_bytes();
    });
}

/// Returns the address of the reply, or of the text of the panic.
#[unsafe(no_mangle)]
#[expect(unsafe_code, reason = "an export")]
extern "C" fn output() -> *const u8 {
    let panic = PANIC.with_borrow(|text| (!text.is_empty()).then(|| text.as_ptr()));
    panic.unwrap_or_else(|| with(|module| module.output.as_ptr()))
}

/// Returns the length of the text at `output()`, in bytes.
#[unsafe(no_mangle)]
#[expect(unsafe_code, reason = "an export")]
extern "C" fn output_len() -> usize {
    match PANIC.with_borrow(String::len) {
        0 => with(|module| module.output.len()),
        length => length,
    }
}

/// Returns the number of individuals.
#[unsafe(no_mangle)]
#[expect(unsafe_code, reason = "an export")]
extern "C" fn n() -> usize {
    with(|module| module.engine.ids().len())
}

/// Returns the address of the ids.
#[unsafe(no_mangle)]
#[expect(unsafe_code, reason = "an export")]
extern "C" fn ids() -> *const u32 {
    with(|module| {
        module.ids = module.engine.ids().to_vec();
        module.ids.as_ptr()
    })
}

/// Returns the address of the numbers of a column, as [`Engine::column`] describes it.
#[unsafe(no_mangle)]
#[expect(unsafe_code, reason = "an export")]
extern "C" fn column(index: usize) -> *const f64 {
    with(|module| {
        module.column = module.engine.column(index);
        module.column.as_ptr()
    })
}
