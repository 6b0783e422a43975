//! Three forms of output: a line a second, samples as JSON, and complete states as JSON.

use jostle_proto::{OrderSample, State};

use crate::failure::Failure;
use crate::format;
use crate::output::{self, Output};

/// The significant digits of measures; `--json` has all.
const DIGITS: usize = 4;

/// A form of output. The methods that print return the number of printed lines.
pub enum View {
    /// Complete states, a JSON line each.
    Frames,
    /// Samples as received, a JSON line each.
    Samples,
    /// For people: a header and at most a line a second.
    Lines {
        /// The sample of the next line.
        latest: Option<Box<OrderSample>>,
        /// Whether the header and a first line are printed.
        is_begun: bool,
    },
}

impl View {
    /// The form that the options select.
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
    pub fn line(&self, text: &str) -> Result<u64, Failure> {
        output::write(&format!("{text}\n")).map(|()| 1)
    }

    /// Prints a state as a line of JSON.
    pub fn state(&self, state: &State) -> Result<u64, Failure> {
        let text = serde_json::to_string(state).map_err(Failure::defect)?;
        self.line(&text)
    }

    /// Shows a sample to people.
    pub fn order(&mut self, sample: OrderSample) -> Result<u64, Failure> {
        match self {
            View::Frames | View::Samples => Ok(0),
            View::Lines { latest, is_begun } => {
                *latest = Some(Box::new(sample));
                if *is_begun {
                    return Ok(0);
                }
                *is_begun = true;
                let header = [
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
                    "degraded",
                ];
                output::write(&line(header))?;
                self.tick()
            }
        }
    }

    /// Prints the next line, if there is a new sample.
    pub fn tick(&mut self) -> Result<u64, Failure> {
        let View::Lines { latest, .. } = self else {
            return Ok(0);
        };
        match latest.take() {
            Some(sample) => output::write(&describe(&sample)).map(|()| 1),
            None => Ok(0),
        }
    }
}

fn describe(sample: &OrderSample) -> String {
    let line = line([
        &sample.step.to_string(),
        &format::time(sample.time),
        sample.phase.name(),
        &sample.n.to_string(),
        &sample.informed.to_string(),
        &format::share(Some(sample.order.order)),
        &format::share(sample.order.drift),
        &format::rate(sample.rate),
        &format::factor(sample.real_time_factor),
        &format::magnitude(sample.certificate.worst_gap),
        &sample.certificate.degraded.to_string(),
    ]);
    let Some(measures) = &sample.measures else {
        return line;
    };
    let values = measures.iter().map(|(name, value)| {
        let value = value.map(|value| format::rounded(value, DIGITS));
        format!("  {name}={}", format::or_none(value))
    });
    format!("{}{}\n", line.trim_end(), values.collect::<String>())
}

fn line(cells: [&str; 11]) -> String {
    let [
        step,
        time,
        phase,
        n,
        informed,
        order,
        drift,
        rate,
        actual,
        gap,
        degraded,
    ] = cells;
    format!(
        "{step:>9} {time:>10} {phase:7} {n:>5} {informed:>8} {order:>6} {drift:>6} {rate:>6} \
         {actual:>6} {gap:>9} {degraded:>8}\n"
    )
}
