//! Thread CPU time of a step: the exact solver, and other solvers on the same work.
//!
//! `cargo bench -p jostle-physics-benches --bench step -- --help` lists the options. For every
//! length over width and size a settled group is computed once and cached below `target/`. 10 to
//! 200 successive steps of it are recorded, and every backend solves the recorded programs, in
//! alternating repetitions of which the quickest counts. `docs/performance.md` explains the tables
//! in `docs/performance/`.

mod arguments;
mod backend;
mod clarabel;
mod document;
mod measure;
mod outsiders;
mod phases;
mod picture;
mod rapier;
mod record;
mod settled;
mod table;

use std::path::{Path, PathBuf};

use arguments::Arguments;
use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use table::Row;

fn main() {
    let arguments = Arguments::parse();
    let cases = arguments.cases();
    let progress = ProgressBar::new(cases.len() as u64);
    let style = ProgressStyle::with_template("{bar:24} {pos}/{len} {msg} ({elapsed})");
    progress.set_style(style.expect("the template is well formed"));
    let mut rows: Vec<Row> = Vec::new();
    if !arguments.json {
        println!("{}", table::heading());
    }
    for case in cases {
        progress.set_message(format!("pi1 = {}, n = {}", case.pi1, case.n));
        progress.tick();
        let measured = measure::measure(case, &arguments);
        progress.suspend(|| {
            for row in &measured {
                let line = if arguments.json {
                    table::json(row)
                } else {
                    table::text(row)
                };
                println!("{line}");
            }
        });
        rows.extend(measured);
        progress.inc(1);
    }
    progress.finish_and_clear();
    if !arguments.json {
        println!("\n{}", table::errors(&rows));
    }
    if let Some(path) = &arguments.svg {
        write(path, &picture::svg(&rows));
    }
    if arguments.write_docs {
        write(&docs("performance/step.svg"), &picture::svg(&rows));
        write(&docs("performance/step.csv"), &table::csv(&rows));
        write(&docs("performance/errors.csv"), &table::errors_csv(&rows));
        let path = docs("performance.md");
        let page = std::fs::read_to_string(&path).expect("docs/performance.md can be read");
        write(&path, &document::with_tables(&page, &rows));
    }
}

/// Returns the path of a file in `docs`.
fn docs(name: &str) -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs")).join(name)
}

fn write(path: &Path, text: &str) {
    std::fs::write(path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}
