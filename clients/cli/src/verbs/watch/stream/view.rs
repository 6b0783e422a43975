//! Three ways to show a swarm: a line a second, samples and whole states as JSON.

use jostle_proto::{OrderSample, State};

use crate::failure::Failure;
use crate::format;
use crate::output::{self, Output};

/// A way to show a swarm. What shows something returns how many it has shown.
pub enum View {
    /// Whole states, a JSON line each.
    Frames,
    /// Samples as they come, a JSON line each.
    Samples,
    /// For people: a header and at most a line a second.
    Lines {
        /// What the next line will show.
        latest: Option<Box<OrderSample>>,
        /// Whether the header and a first line are printed.
        is_begun: bool,
    },
}

impl View {
    /// The way to show it that was asked for.
    pub fn new(output: Output, frames: bool) -> Self {
        if frames {
            return View::Frames;
        }
        if output.json {
            return View::Samples;
        }
        View::Lines {
            latest: None,
            is_begun: false,
        }
    }

    /// Prints a line of JSON.
    ///
    /// # Errors
    ///
    /// When it cannot be written.
    pub fn line(&self, text: &str) -> Result<u64, Failure> {
        output::write(&format!("{text}\n")).map(|()| 1)
    }

    /// Prints a state as a line of JSON.
    ///
    /// # Errors
    ///
    /// When it cannot be written.
    pub fn state(&self, state: &State) -> Result<u64, Failure> {
        let text = serde_json::to_string(state).map_err(Failure::defect)?;
        self.line(&text)
    }

    /// Shows a sample to people.
    ///
    /// # Errors
    ///
    /// When it cannot be written.
    pub fn order(&mut self, sample: OrderSample) -> Result<u64, Failure> {
        match self {
            View::Frames | View::Samples => Ok(0),
            View::Lines { latest, is_begun } => {
                *latest = Some(Box::new(sample));
                if *is_begun {
                    return Ok(0);
                }
                *is_begun = true;
                output::write(&header())?;
                self.tick()
            }
        }
    }

    /// Prints the line that is due, if there is anything new.
    ///
    /// # Errors
    ///
    /// When it cannot be written.
    pub fn tick(&mut self) -> Result<u64, Failure> {
        let View::Lines { latest, .. } = self else {
            return Ok(0);
        };
        match latest.take() {
            Some(sample) => output::write(&line(&sample)).map(|()| 1),
            None => Ok(0),
        }
    }
}

fn header() -> String {
    format!(
        "{:>9} {:>10} {:7} {:>5} {:>8} {:>6} {:>6} {:>6} {:>6} {:>9} {:>8}\n",
        "step",
        "time",
        "phase",
        "n",
        "informed",
        "order",
        "drift",
        "rate",
        "actual",
        "worst_gap",
        "degraded"
    )
}

fn line(sample: &OrderSample) -> String {
    format!(
        "{:>9} {:>10} {:7} {:>5} {:>8} {:>6} {:>6} {:>6} {:>6} {:>9} {:>8}\n",
        sample.step,
        format::time(sample.time),
        format::phase(sample.phase),
        sample.n,
        sample.informed,
        format::share(Some(sample.order.order)),
        format::share(sample.order.drift),
        format::rate(sample.rate),
        format::factor(sample.real_time_factor),
        format::magnitude(sample.certificate.worst_gap),
        sample.certificate.degraded,
    )
}
