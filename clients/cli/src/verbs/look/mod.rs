//! The verbs that only look, once or again and again.

mod controllers;
mod journal;
mod nodes;
mod parameters;
mod show;
mod top;

use std::time::{Duration, Instant};

use jostle_proto::Metrics;
use serde::de::DeserializeOwned;

pub use self::journal::{Whole, whole};
use crate::arguments::Look;
use crate::bus::{Answer, Bus};
use crate::failure::Failure;
use crate::output::{self, Output};
use crate::screen::Screen;
use crate::verbs::lookout::{GONE, RISE};

/// What there is to see.
struct Sight {
    /// For stdout; nothing if there is nothing.
    data: Option<String>,
    /// For whoever looks on.
    note: Option<String>,
}

impl Sight {
    /// Data without a word.
    fn of(data: String) -> Self {
        Sight {
            data: Some(data),
            note: None,
        }
    }

    /// An answer as it came, or in the words of `tell`.
    fn of_answer<T: DeserializeOwned>(
        output: Output,
        answer: &Answer,
        tell: impl FnOnce(&T) -> String,
    ) -> Result<Self, Failure> {
        let data = if output.json {
            answer.json()?.to_owned()
        } else {
            tell(&answer.read()?)
        };
        Ok(Sight::of(data))
    }
}

/// Looks, and again if asked to.
///
/// # Errors
///
/// Why there is nothing to see, or nothing any more.
pub async fn look(bus: &Bus, output: Output, look: &Look) -> Result<(), Failure> {
    let mut before = None;
    let Some(secs) = look.every_secs() else {
        let Sight { data, note } = sight(bus, output, look, &mut before).await?;
        if let Some(note) = note {
            output.note(&note);
        }
        return data.map_or(Ok(()), |data| output.data(&data));
    };
    let mut repeated = Repeated::new(output);
    repeated.show(sight(bus, output, look, &mut before).await?, bus.lost())?;
    let mut left = look.count().map(|count| count - 1);
    while left != Some(0) {
        tokio::time::sleep(Duration::from_secs_f64(secs)).await;
        match sight(bus, output, look, &mut before).await {
            Ok(sight) => {
                repeated.show(sight, bus.lost())?;
                left = left.map(|left| left - 1);
            }
            Err(failure) if failure.is_passing() => repeated.miss(&failure)?,
            Err(failure) if repeated.may_come_back(&failure, bus.lost()) => {}
            Err(failure) => return Err(failure),
        }
    }
    Ok(())
}

/// Looks once; some sights are of what came about since the one before.
async fn sight(
    bus: &Bus,
    output: Output,
    look: &Look,
    before: &mut Option<Metrics>,
) -> Result<Sight, Failure> {
    match look {
        Look::List(_) => show::list(bus, output).await,
        Look::Status(arguments) => show::status(bus, output, &arguments.name).await,
        Look::Spec(arguments) => show::spec(bus, output, &arguments.name).await,
        Look::Controllers(arguments) => controllers::sight(bus, output, &arguments.name).await,
        Look::Parameters(arguments) => parameters::sight(bus, output, &arguments.name).await,
        Look::Journal(arguments) => journal::sight(bus, output, arguments).await,
        Look::Nodes(_) => nodes::sight(bus, output).await,
        Look::Top(arguments) => top::sight(bus, output, arguments, before).await,
    }
}

/// What is looked at again and again: in place on a terminal, one after the other elsewhere.
struct Repeated {
    output: Output,
    screen: Option<Screen>,
    is_begun: bool,
    /// Whether it was told that nobody answers, until it is seen again.
    is_missed: bool,
    /// Since when the answer is that there is no such swarm, and how many connections had been
    /// lost when it was seen last.
    missing: Option<Instant>,
    lost: u64,
    text: String,
}

impl Repeated {
    fn new(output: Output) -> Self {
        Repeated {
            output,
            screen: (!output.json && output::is_terminal()).then(Screen::default),
            is_begun: false,
            is_missed: false,
            missing: None,
            lost: 0,
            text: String::new(),
        }
    }

    fn show(&mut self, sight: Sight, lost: u64) -> Result<(), Failure> {
        (self.is_missed, self.missing, self.lost) = (false, None, lost);
        let text = sight.data.or(sight.note.filter(|_| !self.output.json));
        let text = text.unwrap_or_default();
        if let Some(screen) = &mut self.screen {
            screen.draw(&text, None)?;
        } else if self.output.json || !self.is_begun {
            self.output.data(&text)?;
        } else {
            self.output.data(&format!("\n{text}"))?;
        }
        self.is_begun = true;
        self.text = text;
        Ok(())
    }

    /// Whether what is not there may come back: after a lost connection a swarm is known a moment
    /// later than the daemon that hosts it.
    fn may_come_back(&mut self, failure: &Failure, lost: u64) -> bool {
        if failure.code() != "not_found" {
            return false;
        }
        match self.missing {
            None => {
                self.missing = Some(Instant::now());
                true
            }
            Some(since) => lost != self.lost && since.elapsed() < RISE,
        }
    }

    /// Says once what prevents a look, and keeps what was seen last.
    fn miss(&mut self, failure: &Failure) -> Result<(), Failure> {
        self.missing = None;
        if std::mem::replace(&mut self.is_missed, true) {
            return Ok(());
        }
        let said = match failure {
            Failure::NoDaemon { .. } | Failure::NoNode { .. } => GONE.to_owned(),
            _ => format!("{failure}; looking again, Ctrl-C ends"),
        };
        match &mut self.screen {
            Some(screen) => screen.draw(&self.text, Some(&said)),
            None => {
                self.output.note(&said);
                Ok(())
            }
        }
    }
}
