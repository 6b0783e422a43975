//! Four ways to show a swarm: a panel, a line a second, samples and whole states as JSON.

use jostle_proto::{OrderSample, State};

use crate::failure::Failure;
use crate::format;
use crate::output::{self, Output};
use crate::screen::Screen;

/// The width of the order's bar.
const BAR_WIDTH: usize = 20;

/// A way to show a swarm. What shows something returns how many it has shown.
pub enum View {
    /// Whole states, a JSON line each.
    Frames,
    /// Samples as they come, a JSON line each.
    Samples,
    /// On a terminal: a few lines that change in place.
    Panel {
        /// Where they are drawn.
        screen: Screen,
        /// The lines about the swarm.
        text: String,
        /// The line below, when there is something to say.
        notice: Option<&'static str>,
    },
    /// Elsewhere: a header and at most a line a second.
    Lines {
        /// What the next line will show.
        latest: Option<Box<OrderSample>>,
        /// Whether the header and a first line are printed.
        is_begun: bool,
    },
}

impl View {
    /// The way to show it that was asked for or, if none was, that fits stdout.
    pub fn new(output: Output, frames: bool) -> Self {
        if frames {
            return View::Frames;
        }
        if output.json {
            return View::Samples;
        }
        if !output::is_terminal() {
            return View::Lines {
                latest: None,
                is_begun: false,
            };
        }
        View::Panel {
            screen: Screen::default(),
            text: String::new(),
            notice: None,
        }
    }

    /// Tells whether a notice stays in sight.
    pub fn is_panel(&self) -> bool {
        matches!(self, View::Panel { .. })
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
            View::Panel {
                screen,
                text,
                notice,
            } => {
                *text = panel(&sample);
                screen.draw(text, *notice).map(|()| 1)
            }
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

    /// Says what is the matter, until told that it no longer is.
    ///
    /// # Errors
    ///
    /// When it cannot be written.
    pub fn notice(&mut self, output: Output, said: Option<&'static str>) -> Result<(), Failure> {
        match (self, said) {
            (
                View::Panel {
                    screen,
                    text,
                    notice,
                },
                said,
            ) => {
                *notice = said;
                screen.draw(text, said)
            }
            (_, Some(said)) => {
                output.note(said);
                Ok(())
            }
            (_, None) => Ok(()),
        }
    }
}

/// A swarm on five lines.
fn panel(sample: &OrderSample) -> String {
    let OrderSample {
        swarm,
        step,
        n,
        informed,
        order,
        certificate,
        ..
    } = sample;
    let phase = format::phase(sample.phase);
    let time = format::time(sample.time);
    let rate = format::rate(sample.rate);
    let actual = format::factor(sample.real_time_factor);
    let bar = format::bar(order.order, BAR_WIDTH);
    let (now, mean) = (
        format::share(Some(order.order)),
        format::share(order.mean_order),
    );
    let drift = match order.direction {
        Some(direction) => format!(
            "drift {}  mean {}  along {}",
            format::share(order.drift),
            format::share(order.mean_drift),
            format::time(direction),
        ),
        None => "no common direction, no drift".into(),
    };
    let gap = format::magnitude(certificate.worst_gap);
    let degraded = format::count(certificate.degraded, "step");
    let crossed = format::count(certificate.crossed, "pair");
    format!(
        "{swarm}  {phase}  step {step}  time {time}\n\
         n {n}  informed {informed}  rate {rate}  actual {actual}\n\
         order {bar} {now}  mean {mean}\n\
         {drift}\n\
         worst gap {gap}  degraded {degraded}  crossed {crossed}"
    )
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
