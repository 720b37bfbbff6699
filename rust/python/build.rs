//! Builds the C library that a wheel ships, under the feature `c-library`, which `pyproject.toml` turns on.
//!
//! It is a library without std, of another profile, so it cannot be a dependency: cargo is called for it, with a target
//! folder of its own in `OUT_DIR`. Libraries, header, and what pkg-config and `CMake` read then stand in `OUT_DIR/c`, as
//! they will stand in the wheel.

use std::env;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

type Done = Result<(), Box<dyn Error>>;

fn main() -> Done {
    println!("cargo:rerun-if-changed=build.rs");
    if env::var_os("CARGO_FEATURE_C_LIBRARY").is_none() {
        return Ok(());
    }
    let rust = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join("..");
    for read in [
        "c/src",
        "c/include",
        "c/package",
        "c/examples/wheel",
        "c/Cargo.toml",
        "core/src",
    ] {
        println!("cargo:rerun-if-changed={}", rust.join(read).display());
    }
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let built = build(&rust, &out.join("target"))?;
    package(&rust.join("c"), &built, &out.join("c"))
}

/// Compiles the library for the target of the wheel; returns the folder that holds it.
fn build(rust: &Path, target_dir: &Path) -> Result<PathBuf, Box<dyn Error>> {
    let target = env::var("TARGET")?;
    let mut cargo = Command::new(env::var("CARGO")?);
    cargo
        .args(["rustc", "--quiet", "--locked", "--profile", "control"])
        .args(["--package", "sherkit-c", "--lib", "--target", &target])
        .args(["--crate-type", kinds(&target)])
        .arg("--target-dir")
        .arg(target_dir)
        .current_dir(rust.join(".."));
    // what cargo tells this script about its own crate must not reach another
    for (name, _) in env::vars() {
        let own = ["CARGO_FEATURE_", "CARGO_CFG_", "CARGO_PKG_"];
        if own.iter().any(|start| name.starts_with(start)) {
            cargo.env_remove(name);
        }
    }
    if target.contains("musl") {
        // a shared library needs a libc that is shared, too
        let flags = env::var("CARGO_ENCODED_RUSTFLAGS").unwrap_or_default();
        let dynamic = "-Ctarget-feature=-crt-static";
        let all: Vec<_> = flags
            .split('\x1f')
            .filter(|f| !f.is_empty())
            .chain([dynamic])
            .collect();
        cargo.env("CARGO_ENCODED_RUSTFLAGS", all.join("\x1f"));
    }
    // without std nobody names the C library, which has memcpy
    let shared: &[&str] = if target.contains("linux") {
        &["-lc", "-Wl,-soname,libsherkit.so", "-Wl,-z,defs"]
    } else if target.contains("apple") {
        &["-lSystem", "-Wl,-install_name,@rpath/libsherkit.dylib"]
    } else {
        &[]
    };
    cargo.arg("--");
    for argument in shared {
        cargo.arg(format!("-Clink-arg={argument}"));
    }
    let status = cargo.status()?;
    if !status.success() {
        return Err(format!("the C library could not be built: {status}").into());
    }
    Ok(target_dir.join(target).join("control"))
}

/// A library without std begins as a DLL only with parts of the C runtime that nobody names here.
fn kinds(target: &str) -> &'static str {
    if target.contains("windows") {
        "staticlib"
    } else {
        "staticlib,cdylib"
    }
}

/// Lays out what the wheel ships.
fn package(c: &Path, built: &Path, to: &Path) -> Done {
    let version = env::var("CARGO_PKG_VERSION")?;
    let (series, _) = version
        .rsplit_once('.')
        .ok_or("a version has three parts")?;
    let [lib, include, example] = ["lib", "include", "example"].map(|name| to.join(name));
    let (pkgconfig, cmake) = (lib.join("pkgconfig"), lib.join("cmake/sherkit"));
    // what an earlier build left
    let _ = fs::remove_dir_all(to);
    for folder in [&lib, &include, &example, &pkgconfig, &cmake] {
        fs::create_dir_all(folder)?;
    }
    fs::copy(c.join("include/sherkit.h"), include.join("sherkit.h"))?;
    for name in ["loop.c", "CMakeLists.txt"] {
        fs::copy(c.join("examples/wheel").join(name), example.join(name))?;
    }
    for name in [
        "libsherkit.a",
        "libsherkit.so",
        "libsherkit.dylib",
        "sherkit.lib",
    ] {
        if built.join(name).is_file() {
            fs::copy(built.join(name), lib.join(name))?;
        }
    }
    for (name, folder) in [
        ("sherkit.pc", &pkgconfig),
        ("sherkit-config.cmake", &cmake),
        ("sherkit-config-version.cmake", &cmake),
    ] {
        let text = fs::read_to_string(c.join("package").join(format!("{name}.in")))?;
        fs::write(
            folder.join(name),
            text.replace("@VERSION@", &version)
                .replace("@SERIES@", series),
        )?;
    }
    Ok(())
}
