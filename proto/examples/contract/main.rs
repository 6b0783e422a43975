//! Writes all that is made from the contract: `schema/`, `asyncapi.json`, and the tables in
//! `README.md`.
//!
//! ```sh
//! cargo run --release -p jostle-proto --example contract
//! ```

mod generate;

use std::fs;

fn main() -> std::io::Result<()> {
    let folder = generate::folder();
    let schemas = folder.join("schema");
    fs::create_dir_all(&schemas)?;
    for stale in fs::read_dir(&schemas)? {
        fs::remove_file(stale?.path())?;
    }
    for (path, text) in generate::files()? {
        fs::write(folder.join(path), text)?;
    }
    Ok(())
}
