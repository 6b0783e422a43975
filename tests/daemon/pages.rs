//! The tests and files that the pages name exist, and every claim without exception on the pages
//! about guarantees and security has a test or a command beside it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::support::programs::ROOT;

/// The suites whose tests a page names without a command.
const WITHOUT_COMMAND: [&str; 3] = [DAEMON, "--test measured", "--test architecture"];
const DAEMON: &str = "--test daemon";

/// Where the tests of each suite are, by the arguments of `cargo test` that select it.
const SUITES: [(&str, &str); 10] = [
    (DAEMON, "tests/daemon"),
    ("--test measured", "tests/measured"),
    ("--test architecture", "tests/architecture"),
    ("--test physics", "crates/physics/tests/physics"),
    ("--test cli", "clients/cli/tests/cli"),
    ("--lib", "src"),
    ("-p jostle-results", "crates/results/src"),
    ("-p jostle-physics", "crates/physics"),
    ("-p jostle-experiment", "crates/experiment/src"),
    ("-p jostle-proto", "proto"),
];

/// Words of a claim without exception; so is "no … can".
const ABSOLUTE: [&str; 3] = ["never", "always", "every"];

/// The tables that have a proof in each row.
const TABLES: [&str; 2] = [
    "What a reply means",
    "Threats, and the test that shows each defence",
];

fn root() -> &'static Path {
    Path::new(ROOT)
}

/// The files below a folder whose names end so, by their paths from the root of the repository.
fn files(folder: &str, ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(root().join(folder)).unwrap() {
        let path = entry.unwrap().path();
        let here = path.strip_prefix(root()).unwrap().to_path_buf();
        if path.is_dir() {
            found.extend(files(here.to_str().unwrap(), ending));
        } else if path.to_str().unwrap().ends_with(ending) {
            found.push(here);
        }
    }
    found.sort();
    found
}

/// Every test below a folder, by its module and name as `cargo test` lists it, but for a module
/// `tests` beside the code.
fn tests(folder: &str) -> Vec<String> {
    let mut tests = Vec::new();
    for file in files(folder, ".rs") {
        let module = file.strip_prefix(folder).unwrap().with_extension("");
        let parts = module.iter().map(|part| part.to_str().unwrap());
        let parts = parts.filter(|part| !["mod", "main", "lib"].contains(part));
        let module: String = parts.map(|part| format!("{part}::")).collect();
        let text = fs::read_to_string(root().join(&file)).unwrap();
        let mut is_test = false;
        for line in text.lines().map(str::trim) {
            is_test |= line == "#[test]" || line.starts_with("#[tokio::test");
            let name = line.strip_prefix("async ").unwrap_or(line);
            if let Some(rest) = name.strip_prefix("fn ")
                && std::mem::take(&mut is_test)
            {
                let name = rest.split(['(', '<']).next().unwrap();
                tests.push(format!("{module}{name}"));
            }
        }
    }
    tests
}

/// Every test of every suite.
fn suites() -> BTreeMap<&'static str, Vec<String>> {
    let suites: BTreeMap<_, _> = SUITES
        .iter()
        .map(|(suite, folder)| (*suite, tests(folder)))
        .collect();
    for (suite, tests) in &suites {
        assert!(tests.len() >= 5, "{suite}: {} tests", tests.len());
    }
    suites
}

/// A paragraph, a list item, a row of a table or a command of a page.
struct Block {
    /// Where it begins, for messages: the page and the line.
    place: String,
    /// The heading that it stands below.
    heading: String,
    text: String,
}

/// The blocks of a page, without what stands between fences.
fn blocks(page: &Path) -> Vec<Block> {
    let text = fs::read_to_string(root().join(page)).unwrap();
    let (mut blocks, mut heading): (Vec<Block>, _) = (Vec::new(), String::new());
    let (mut is_fenced, mut continues) = (false, false);
    for (line, number) in text.lines().zip(1..) {
        if line.starts_with("```") {
            (is_fenced, continues) = (!is_fenced, false);
            continue;
        }
        if line.starts_with('#') {
            heading = line.trim_matches(['#', ' ']).to_owned();
        }
        let begins = ["#", "|", "- ", "    "]
            .iter()
            .any(|it| line.starts_with(it));
        if is_fenced || line.trim().is_empty() {
            continues = false;
            continue;
        }
        match blocks.last_mut() {
            Some(block) if continues && !begins => {
                block.text.push(' ');
                block.text.push_str(line.trim());
            }
            _ => blocks.push(Block {
                place: format!("{}:{number}", page.display()),
                heading: heading.clone(),
                text: line.trim().to_owned(),
            }),
        }
        continues = true;
    }
    blocks
}

/// Something that a block names as its proof.
#[derive(Debug)]
enum Proof {
    /// A test of the daemon, by the beginning of its name.
    Test(String),
    /// A word that a command selects tests by.
    Selection(String, String),
    /// A file.
    File(String),
    /// A command that is no test.
    Command,
}

/// The suite that a command runs, and the word by which it selects tests, if it is `cargo test`.
fn selection(command: &str) -> Option<(String, Option<String>)> {
    let rest = command.split_once("cargo test ")?.1;
    let (suite, _) = SUITES.iter().find(|(suite, _)| rest.contains(suite))?;
    let words = rest.split_once(suite)?.1;
    let mut words = words.split_whitespace().filter(|word| *word != "--");
    let word = words.find(|it| it.starts_with(|c: char| c.is_ascii_lowercase()));
    Some(((*suite).to_owned(), word.map(str::to_owned)))
}

/// Whether a text is the name of a test or of a module of tests.
fn is_name(text: &str) -> bool {
    let is_part = |part: &str| {
        part.chars()
            .all(|c| c.is_ascii_lowercase() || c == '_' || c.is_ascii_digit())
    };
    let begins = text.starts_with(|c: char| c.is_ascii_lowercase());
    text.contains("::") && begins && text.split("::").all(is_part)
}

/// The proofs that a block names: in backticks or, of tests, without.
fn proofs(text: &str) -> Vec<Proof> {
    let mut proofs = Vec::new();
    let pieces: Vec<&str> = text.split('`').collect();
    for (at, piece) in pieces.iter().enumerate() {
        if at % 2 == 0 {
            let words = piece.split(|c: char| !(c.is_ascii_alphanumeric() || "_:".contains(c)));
            let names = words.filter(|word| is_name(word));
            proofs.extend(names.map(|it| Proof::Test(it.into())));
            continue;
        }
        let next = pieces.get(at + 1).zip(pieces.get(at + 2));
        let elsewhere = next.filter(|(between, _)| **between == " in ");
        let elsewhere = elsewhere.and_then(|(_, command)| selection(command));
        if let Some((suite, _)) = elsewhere {
            proofs.push(match piece.contains('/') {
                true => Proof::File((*piece).to_owned()),
                false => Proof::Selection(suite, (*piece).to_owned()),
            });
        } else if is_name(piece) {
            proofs.push(Proof::Test((*piece).to_owned()));
        } else if let Some((suite, word)) = selection(piece) {
            proofs.push(match word {
                Some(word) => Proof::Selection(suite, word),
                None => Proof::Command,
            });
        } else if is_file(piece) {
            proofs.push(Proof::File((*piece).to_owned()));
        } else if ["cargo bench", "./check", "packaging/try-"]
            .iter()
            .any(|it| piece.starts_with(it))
        {
            proofs.push(Proof::Command);
        }
    }
    proofs
}

/// Whether a text is the path of a source.
fn is_file(text: &str) -> bool {
    let endings = [".rs", ".py", ".ts"];
    text.contains('/') && !text.contains([' ', '*']) && endings.iter().any(|it| text.ends_with(it))
}

/// The problem of a proof; `None` if it exists.
fn missing(page: &Path, proof: &Proof, suites: &BTreeMap<&str, Vec<String>>) -> Option<String> {
    match proof {
        Proof::Test(name) => {
            let mut tests = WITHOUT_COMMAND.iter().flat_map(|it| &suites[it]);
            let is_there = tests.any(|it| it.starts_with(name));
            (!is_there).then(|| format!("no test of {WITHOUT_COMMAND:?} begins with {name}"))
        }
        Proof::Selection(suite, word) => {
            let is_there = suites[suite.as_str()].iter().any(|it| it.contains(word));
            (!is_there).then(|| format!("no test of {suite} has {word} in its name"))
        }
        Proof::File(file) => {
            let beside = page.parent().unwrap().join(file);
            let is_there = root().join(file).exists() || root().join(beside).exists();
            (!is_there).then(|| format!("there is no {file}"))
        }
        Proof::Command => None,
    }
}

/// The documentation.
fn pages() -> Vec<PathBuf> {
    let mut pages = files("docs", ".md");
    for page in [
        "README.md",
        "proto/README.md",
        "clients/python/README.md",
        "fuzz/README.md",
    ] {
        pages.push(page.into());
    }
    pages
}

#[test]
fn what_a_page_names_as_its_proof_exists() {
    let suites = suites();
    let (mut wrong, mut named) = (Vec::new(), 0);
    for page in pages() {
        for block in blocks(&page) {
            for proof in proofs(&block.text) {
                named += usize::from(matches!(proof, Proof::Test(..)));
                let missing = missing(&page, &proof, &suites);
                wrong.extend(missing.map(|it| format!("{}: {it}", block.place)));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(named >= 100, "only {named} tests are named");
}

#[test]
fn a_claim_without_exception_names_its_proof() {
    let (mut bare, mut claims) = (Vec::new(), 0);
    for page in ["docs/guarantees.md", "docs/security.md"] {
        for block in blocks(Path::new(page)) {
            // The table of roles is compared with the daemon by `rights::matrix`.
            let is_judged_elsewhere = block.heading == "Roles";
            let is_row = block.text.starts_with("| ") && !block.text.ends_with("| test |");
            let is_promise = TABLES.contains(&&*block.heading) && is_row;
            if is_judged_elsewhere || !(is_promise || is_absolute(&block.text)) {
                continue;
            }
            claims += 1;
            if proofs(&block.text).is_empty() {
                bare.push(format!("{}: {}", block.place, block.text));
            }
        }
    }
    assert!(bare.is_empty(), "neither a test nor a command: {bare:#?}");
    assert!(claims >= 30, "only {claims} claims are found");
}

/// Whether a text claims something without exception, outside backticks.
fn is_absolute(text: &str) -> bool {
    let quoted: String = text.split('`').step_by(2).collect();
    let quoted = quoted.to_lowercase();
    let words = quoted.split(|c: char| !c.is_alphanumeric());
    let words: Vec<&str> = words.filter(|it| !it.is_empty()).collect();
    let excludes = |words: &[&str]| words[0] == "no" && words[2] == "can";
    words.iter().any(|it| ABSOLUTE.contains(it)) || words.windows(3).any(excludes)
}

#[test]
fn the_names_in_a_block_are_found() {
    let read = |text: &str| format!("{:?}", proofs(text));
    assert_eq!(
        read("So it is: `once::what`, `a` and crash::disk::full."),
        "[Test(\"once::what\"), Test(\"crash::disk::full\")]"
    );
    assert_eq!(
        read("`rights` in `cargo test --release --test cli`"),
        "[Selection(\"--test cli\", \"rights\"), Command]"
    );
    assert_eq!(
        read("`cargo test --release -p jostle-results damaged`, `src/a.rs`, `x/*.rs`"),
        "[Selection(\"-p jostle-results\", \"damaged\"), File(\"src/a.rs\")]"
    );
    assert_eq!(read("`jostle::State`, `verify`, 12::30"), "[]");
    assert!(is_absolute("It is Never so") && is_absolute("No reader can."));
    assert!(!is_absolute("`every` step") && !is_absolute("no reader may"));
}
