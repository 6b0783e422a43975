//! Writes all that is made from the contract: `schema/`, `asyncapi.json`, the tables in
//! `README.md`, and the types of the clients in Python and TypeScript.
//!
//! ```sh
//! cargo run --release -p jostle-contract
//! ```

use std::fs;

fn main() -> std::io::Result<()> {
    // Nothing is removed if a file cannot be made.
    let files = jostle_contract::files()?;
    let folder = jostle_contract::folder();
    let schemas = folder.join("schema");
    fs::create_dir_all(&schemas)?;
    for stale in fs::read_dir(&schemas)? {
        fs::remove_file(stale?.path())?;
    }
    for (path, text) in files {
        fs::write(folder.join(path), text)?;
    }
    Ok(())
}
