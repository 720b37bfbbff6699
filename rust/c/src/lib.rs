//! The C interface of `sherkit-core`: caller-owned state, status codes, no allocation, no locks, no panics.
//!
//! The header in `include` is made from these files, so their comments are C's documentation. Sizes of the opaque
//! objects are plain numbers here, because C must know them; the compiler checks that what they hold fits.
//!
//! That there is no path to a panic is checked by the linker: the panic handler calls a function that does not
//! exist, so a program that could reach it does not link.
#![no_std]
#![allow(
    non_camel_case_types,
    reason = "names of types are C's, as in the header"
)]
#![allow(
    clippy::missing_safety_doc,
    reason = "one rule for all, in the header: pointers are valid or null"
)]
// rustdoc's sections and links mean nothing in C
#![allow(clippy::missing_errors_doc, clippy::doc_markdown)]

mod delta;
mod frame;
mod paper;
mod result;
mod robot;
mod sensing;
mod serial;
mod spherical;
mod status;
mod storage;
mod tool;

use core::panic::PanicInfo;

unsafe extern "C" {
    /// Nowhere defined.
    fn sherkit_has_a_path_to_a_panic() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    // SAFETY: it cannot be called, because nothing that calls it can be linked.
    unsafe { sherkit_has_a_path_to_a_panic() }
}

// Where a program's own fmod is looked for here first, the linker finds that of Rust's compiler_builtins, whose objects name
// a function for unwinding. Nothing unwinds; a definition that gives way to any other lets such a program link.
#[cfg(not(any(windows, target_vendor = "apple")))]
core::arch::global_asm!(
    ".weak rust_eh_personality",
    ".hidden rust_eh_personality",
    ".set rust_eh_personality, 0",
);
