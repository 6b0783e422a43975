//! The functions whose bits depend on the platform: rejected in all crates that compute results.

use std::collections::BTreeSet;
use std::path::Path;

/// The methods that clippy rejects by a file.
fn rejected(file: &str) -> BTreeSet<String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
    let text = std::fs::read_to_string(path).unwrap();
    let file: toml::Value = toml::from_str(&text).unwrap();
    let methods = file["disallowed-methods"].as_array().unwrap().iter();
    methods
        .map(|it| it["path"].as_str().unwrap().to_owned())
        .collect()
}

#[test]
fn the_physics_rejects_the_functions_that_all_crates_reject() {
    let all = rejected("crates/clippy.toml");
    assert!(all.contains("f64::cos") && all.iter().all(|it| it.starts_with("f64::")));
    let physics = rejected("crates/physics/clippy.toml").into_iter();
    let physics: BTreeSet<String> = physics.filter(|it| it.starts_with("f64::")).collect();
    assert_eq!(physics, all);
}

#[test]
fn only_the_physics_has_rules_of_its_own() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates");
    let crates = std::fs::read_dir(root).unwrap().map(|it| it.unwrap());
    let own = crates.filter(|it| it.path().join("clippy.toml").exists());
    let own: BTreeSet<_> = own
        .map(|it| it.file_name().into_string().unwrap())
        .collect();
    assert_eq!(own, ["physics".to_owned()].into());
}
