//! Every file of `fuzz/corpus`, complete and truncated, as input of its target.

use std::path::{Path, PathBuf};

use crate::support::programs::ROOT;

fn fuzz() -> PathBuf {
    Path::new(ROOT).join("fuzz")
}

/// Runs a target with every file of its corpus.
fn check_corpus(target: &str, check: fn(&[u8])) {
    let bin = fuzz().join("fuzz_targets").join(format!("{target}.rs"));
    assert!(bin.exists(), "{target} is not fuzzed");
    let mut files = 0;
    for file in std::fs::read_dir(fuzz().join("corpus").join(target)).unwrap() {
        let path = file.unwrap().path();
        let data = std::fs::read(&path).unwrap();
        // Shown if it panics, so that the file is known.
        println!("{}", path.display());
        for length in [data.len(), data.len() / 2, data.len().saturating_sub(1)] {
            check(&data[..length]);
        }
        files += 1;
    }
    assert!(files >= 10, "{target}: {files} files");
}

macro_rules! targets {
    ($($target:ident),*) => {
        $(
            #[test]
            fn $target() {
                check_corpus(stringify!($target), crate::targets::$target::check);
            }
        )*

        const TARGETS: &[&str] = &[$(stringify!($target)),*];
    };
}

targets!(
    experiments,
    messages,
    names,
    orders,
    recordings,
    requests,
    rows,
    selectors,
    sequences,
    settings,
    snapshots,
    states
);

#[test]
fn every_corpus_has_its_target() {
    let folders = std::fs::read_dir(fuzz().join("corpus")).unwrap();
    let mut names: Vec<String> = folders
        .map(|folder| folder.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort_unstable();
    assert_eq!(names, TARGETS);
}
