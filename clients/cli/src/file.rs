//! Reads a file or standard input.

use std::path::Path;

/// Reads a file; `-` is standard input.
pub fn read(path: &Path) -> Result<String, String> {
    let text = if path == Path::new("-") {
        std::io::read_to_string(std::io::stdin())
    } else {
        std::fs::read_to_string(path)
    };
    text.map_err(|error| format!("{}: {error}", path.display()))
}
