//! The daemon's settings, from a file, the environment and flags.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process;
use std::thread;

use jostled::cli::settings;
use jostled::config::Config;

/// A file, an environment and a flag, one after the other with NULs between them: either all
/// values are in range, or the error names the setting.
pub fn check(data: &[u8]) {
    let mut parts = data.split(|byte| *byte == 0);
    let mut text = || String::from_utf8_lossy(parts.next().unwrap_or_default()).into_owned();
    let (name, value, flag) = (text(), text(), text());
    let file = parts.collect::<Vec<_>>().join(&0);
    // One file for each thread that does this at the same time.
    let path: PathBuf = std::env::temp_dir().join(format!(
        "jostled-settings-{}-{:?}.toml",
        process::id(),
        thread::current().id()
    ));
    std::fs::write(&path, file).expect("the temporary folder takes a file");
    let variable = OsString::from(format!("JOSTLED_{name}"));
    let name = name.to_lowercase();
    let file = path.to_str().expect("the temporary folder's name is text");
    // The value of a variable is handled as that of a flag.
    let flags = [("config", file), ("max_hz", &*flag), (&*name, &*value)];
    let given = flags
        .into_iter()
        .filter(|(name, value)| *name != "max_hz" || !value.is_empty());
    let read = settings::check_variables([variable].into_iter())
        .map_err(Into::into)
        .and_then(|()| settings::from_flags(given))
        .and_then(|resolved| Ok(Config::new(&resolved)?));
    std::fs::remove_file(&path).expect("it was just written");
    match read {
        Ok(Config { listen, limits, .. }) => {
            assert!(!listen.is_empty());
            assert!((1..=1_000_000).contains(&limits.max_individuals));
            assert!((1..=100_000).contains(&limits.max_swarms));
            assert!((1..=10_000).contains(&limits.max_hz));
            assert!(limits.max_memory_bytes >= 1 << 20);
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}
