//! Every file of `fuzz/corpus`, complete and truncated, as input of its target.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use jostle_proto::keys;

use crate::support::programs::ROOT;
use crate::targets::orders::{CREATE, FIRST_BYTES};

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
fn the_corpus_of_orders_has_every_verb_a_spec_and_an_unknown_verb() {
    let files = std::fs::read_dir(fuzz().join("corpus/orders")).unwrap();
    let files = files.map(|file| std::fs::read(file.unwrap().path()).unwrap());
    let firsts: BTreeSet<u8> = files.map(|file| file[0] % FIRST_BYTES).collect();
    let verbs = (0..).zip(keys::SWARM_VERBS);
    let missing = verbs.filter(|(first, _)| !firsts.contains(first));
    assert_eq!(missing.collect::<Vec<_>>(), []);
    assert!(firsts.contains(&CREATE) && firsts.contains(&(FIRST_BYTES - 1)));
}

#[test]
fn every_corpus_has_its_target() {
    let folders = std::fs::read_dir(fuzz().join("corpus")).unwrap();
    let mut names: Vec<String> = folders
        .map(|folder| folder.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort_unstable();
    assert_eq!(names, TARGETS);
}
