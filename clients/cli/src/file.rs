//! Reads a file or standard input.

use std::path::Path;

/// Reads a file; `-` is standard input.
pub fn read(path: &Path) -> Result<String, String> {
    let text = if path == Path::new("-") {
        std::io::read_to_string(std::io::stdin())
    } else {
        std::fs::read_to_string(path)
    };
    let text = text.map_err(|error| format!("{}: {error}", path.display()))?;
    // Editors on Windows write a byte order mark, which JSON does not allow.
    Ok(text
        .strip_prefix('\u{feff}')
        .map_or(text.clone(), str::to_owned))
}
