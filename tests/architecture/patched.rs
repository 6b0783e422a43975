//! The libraries that `[patch.crates-io]` replaces by copies with changes.

use std::fs;
use std::path::Path;

use toml::Value;

fn toml(path: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    toml::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// The packages of this name in a lock file.
fn locked(lock: &Value, name: &str) -> Vec<Value> {
    let packages = lock["package"].as_array().unwrap().iter();
    let named = packages.filter(|it| it["name"].as_str() == Some(name));
    named.cloned().collect()
}

/// zenoh's own crate shares a TLS connection between threads without a lock, and nobody would notice
/// until a daemon crashes: Cargo ignores a patch of another version with only a warning.
#[test]
fn the_tls_link_of_zenoh_is_the_copy_without_unsafe_code() {
    for workspace in ["", "fuzz/"] {
        let lock = toml(&format!("{workspace}Cargo.lock"));
        let [link] = <[Value; 1]>::try_from(locked(&lock, "zenoh-link-tls")).unwrap();
        assert_eq!(link.get("source"), None, "{workspace}: not a path");
        let [zenoh] = <[Value; 1]>::try_from(locked(&lock, "zenoh")).unwrap();
        assert_eq!(link["version"], zenoh["version"], "{workspace}");
        assert_eq!(lock.get("patch"), None, "{workspace}: an unused patch");
    }
    let manifest = toml("Cargo.toml");
    let path = manifest["patch"]["crates-io"]["zenoh-link-tls"]["path"].as_str();
    let sources = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join(path.unwrap())
        .join("src");
    let mut files = 0;
    for file in fs::read_dir(sources).unwrap() {
        let text = fs::read_to_string(file.unwrap().path()).unwrap();
        for word in ["unsafe", "UnsafeCell"] {
            assert!(!text.contains(word), "{word}");
        }
        files += 1;
    }
    assert_eq!(files, 3);
}

/// crates.io's `web-time` asks JavaScript for the time: with it the wasm module has imports.
#[test]
fn the_clock_of_clarabel_in_wasm_is_the_stand_in() {
    let lock = toml("Cargo.lock");
    let [clarabel] = <[Value; 1]>::try_from(locked(&lock, "clarabel")).unwrap();
    let needs = clarabel["dependencies"].as_array().unwrap().iter();
    let clock: Vec<_> = needs
        .filter_map(|it| it.as_str()?.strip_prefix("web-time "))
        .collect();
    let mut replaced = locked(&lock, "web-time");
    replaced.retain(|it| it.get("source").is_none());
    let [replaced] = <[Value; 1]>::try_from(replaced).unwrap();
    assert_eq!(clock, [replaced["version"].as_str().unwrap()]);
    assert_eq!(replaced.get("dependencies"), None);
}
