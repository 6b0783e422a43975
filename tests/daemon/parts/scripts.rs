//! Scripts that execute parts: those that `experiment plan` prints, and the commands of
//! `docs/cluster.md`.

use std::fs;
use std::process::Command;

use super::Fixture;
use crate::support::programs::program;

#[test]
fn names_in_a_script_are_neither_options_nor_commands() {
    let fixture = Fixture::new();
    fs::copy(fixture.path("parts.toml"), fixture.path("-p.toml")).unwrap();
    let plan = ["experiment", "plan", "--parts", "2", "--emit", "slurm"];
    let planned = |more: &[&str]| fixture.jostle(&[&plan[..], more].concat());
    let script = planned(&["--out=-o", "--", "-p.toml"]).stdout;
    let script = String::from_utf8(script).unwrap();
    assert!(
        script.contains("\nexec jostled run ./-p.toml --part "),
        "{script}"
    );
    assert!(script.contains("\n  -o ./-o/part-"), "{script}");
    fs::copy(fixture.path("parts.toml"), fixture.path("p\nrm.toml")).unwrap();
    for more in [["p\nrm.toml", "--out=o"], ["parts.toml", "--out=o\rrm"]] {
        let output = planned(&more);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(
            message.contains("a script cannot contain control characters"),
            "{message}"
        );
        assert!(output.stdout.is_empty());
    }
}

/// The text of the blocks of a kind in a section of the page.
fn blocks(section: &str, kind: &str) -> Vec<String> {
    let page = include_str!("../../../docs/cluster.md");
    let start = page.find(&format!("\n## {section}\n")).unwrap();
    let text = &page[start + 1..];
    let text = &text[..text.find("\n## ").unwrap_or(text.len())];
    let open = format!("```{kind}\n");
    let blocks = text.split(open.as_str()).skip(1);
    blocks
        .map(|it| it.split("```").next().unwrap().to_owned())
        .collect()
}

#[test]
fn the_commands_of_the_page_about_clusters_write_one_table() {
    let page = include_str!("../../../docs/cluster.md");
    let toml = page.split("```toml\n").nth(1).unwrap();
    let toml = toml.split("```").next().unwrap();
    // In place of a job array, its elements one after the other; `tests/try-slurm` has a real one.
    let sbatch = "sbatch() { for it in 1 2 3 4; do SLURM_ARRAY_TASK_ID=$it bash \"$1\"; done; }\n";
    let mut tables = Vec::new();
    for (section, count, results) in [
        ("On one machine", 1, "results"),
        ("On several machines, by hand", 1, "merged"),
        ("Slurm", 2, "leaders-results"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("leaders.toml"), toml).unwrap();
        let blocks = blocks(section, "sh");
        assert_eq!(blocks.len(), count, "{section}");
        let jostle = program("jostle");
        let programs = jostle.parent().unwrap();
        let path = std::env::var("PATH").unwrap();
        let output = Command::new("bash")
            .args(["-euc", &format!("{sbatch}{}", blocks.concat())])
            .current_dir(folder.path())
            .env("PATH", format!("{}:{path}", programs.display()))
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(0), "{section}: {output:?}");
        tables.push(fs::read(folder.path().join(results).join("results.csv")).unwrap());
    }
    assert!(tables.iter().all(|it| *it == tables[0]));
    let lines = tables[0].iter().filter(|&&byte| byte == b'\n').count();
    assert_eq!(lines, 41);
}
