//! One version of everything: the workspace's.

use std::path::Path;

use serde_json::Value;

fn read(path: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap()
}

fn toml(path: &str) -> toml::Value {
    toml::from_str(&read(path)).unwrap()
}

fn json(path: &str) -> Value {
    serde_json::from_str(&read(path)).unwrap()
}

#[test]
fn the_python_package_and_the_page_have_the_version_of_the_workspace() {
    let version = toml("Cargo.toml")["workspace"]["package"]["version"].clone();
    let version = version.as_str().unwrap();
    assert_eq!(version, env!("CARGO_PKG_VERSION"));
    let python = toml("clients/python/pyproject.toml");
    assert_eq!(python["project"]["version"].as_str(), Some(version));
    assert_eq!(json("clients/web/package.json")["version"], version);
    let lock = json("clients/web/package-lock.json");
    assert_eq!(lock["version"], version);
    assert_eq!(lock["packages"][""]["version"], version);
    assert!(read("CHANGELOG.md").contains(version), "CHANGELOG.md");
}
