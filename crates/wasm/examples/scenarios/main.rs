//! Scenarios: lists of requests to an engine, whose replies must be the same bytes on every engine.
//!
//! ```text
//! scenarios make SET FOLDER    writes FOLDER/SET.requests and, by this program, FOLDER/SET.replies
//! scenarios answer < REQUESTS  prints the replies to scenarios that were made elsewhere
//! scenarios answer LEVEL       the same by the kernels of a level: baseline, avx2 or avx512
//! ```
//!
//! A request or a reply is a line. An empty line ends a scenario: the next one is executed by another
//! engine, which holds nothing at first. The sets are `a`, random swarms and protocols; `b`, ties, large
//! groups, the fallback solver and what is rejected; `random`, 2,000 further swarms; `large`, a group of
//! 10,000.

mod experiments;
mod fallback;
mod numbers;
#[path = "../../../experiment/src/protocol/tests/random_protocol.rs"]
#[expect(dead_code, reason = "only the text of a protocol is used")]
mod random_protocol;
mod rejected;
mod scenario;
mod swarms;
mod ties;

use std::fs::File;
use std::io::{self, BufRead, BufWriter, Write};
use std::path::Path;

use jostle_physics::model::simd::{self, Level};
use jostle_wasm::Engine;

use crate::scenario::Scenario;

const USAGE: &str = "usage: scenarios make a|b|random|large FOLDER | scenarios answer [LEVEL]";

fn main() -> io::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        ["make", set, folder] => make(set, Path::new(folder)),
        ["answer"] => answer(io::stdin().lock(), BufWriter::new(io::stdout().lock())),
        ["answer", level] => {
            choose(level)?;
            answer(io::stdin().lock(), BufWriter::new(io::stdout().lock()))
        }
        _ => Err(io::Error::other(USAGE)),
    }
}

fn make(set: &str, folder: &Path) -> io::Result<()> {
    std::fs::create_dir_all(folder)?;
    let file = |kind| File::create(folder.join(format!("{set}.{kind}"))).map(BufWriter::new);
    let (mut requests, mut replies) = (file("requests")?, file("replies")?);
    let mut write = |scenario: Scenario| {
        writeln!(requests, "{}\n", scenario.requests.join("\n"))?;
        writeln!(replies, "{}\n", scenario.replies.join("\n"))
    };
    match set {
        "a" => {
            (0..220).try_for_each(|seed| {
                swarms::random("a", seed)
                    .into_iter()
                    .try_for_each(&mut write)
            })?;
            experiments::all().try_for_each(&mut write)?;
        }
        "b" => {
            ties::all().try_for_each(&mut write)?;
            swarms::several_hundred().try_for_each(&mut write)?;
            fallback::all().try_for_each(&mut write)?;
            rejected::all().try_for_each(&mut write)?;
        }
        "random" => {
            (0..2000).try_for_each(|seed| {
                swarms::random("random", seed)
                    .into_iter()
                    .try_for_each(&mut write)
            })?;
        }
        "large" => write(swarms::of_ten_thousand())?,
        _ => return Err(io::Error::other(USAGE)),
    }
    requests.flush()?;
    replies.flush()
}

/// Makes the kernels of this process those of the level with this name.
fn choose(name: &str) -> io::Result<()> {
    let level = Level::available()
        .into_iter()
        .find(|level| format!("{:?}", level.width()).eq_ignore_ascii_case(name))
        .ok_or_else(|| io::Error::other(format!("this processor has no level {name}")))?;
    simd::set_level(level)
        .map_err(|used| io::Error::other(format!("the level is already {used:?}")))
}

fn answer(requests: impl BufRead, mut to: impl Write) -> io::Result<()> {
    let mut engine = Engine::new();
    for request in requests.lines() {
        match request?.as_str() {
            "" => {
                engine = Engine::new();
                writeln!(to)?;
            }
            request => writeln!(to, "{}", engine.request(request))?,
        }
    }
    to.flush()
}
