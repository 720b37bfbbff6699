//! Writes `rust/c/include/sherkit.h` from the sources of `rust/c`; with `--check` it only compares, and fails where the
//! header is not what the sources say.

use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let library = Path::new(env!("CARGO_MANIFEST_DIR")).join("../c");
    let header = library.join("include/sherkit.h");
    let made = cbindgen::Config::from_file(library.join("cbindgen.toml"))
        .and_then(|config| {
            let builder = cbindgen::Builder::new().with_crate(&library);
            builder
                .with_config(config)
                .generate()
                .map_err(|e| e.to_string())
        })
        .map(|bindings| {
            let mut text = Vec::new();
            bindings.write(&mut text);
            text
        });
    let text = match made {
        Ok(text) => text,
        Err(why) => {
            eprintln!("the header cannot be made: {why}");
            return ExitCode::FAILURE;
        }
    };
    if std::env::args().any(|a| a == "--check") {
        if std::fs::read(&header).is_ok_and(|found| found == text) {
            return ExitCode::SUCCESS;
        }
        eprintln!("rust/c/include/sherkit.h is not what rust/c/src says: run `make header`");
        return ExitCode::FAILURE;
    }
    if let Err(why) = std::fs::write(&header, text) {
        eprintln!("the header cannot be written: {why}");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}
