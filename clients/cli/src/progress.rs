//! Progress bars on stderr.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::output::Output;

/// How often the spinner and the elapsed time are redrawn.
const TICK: Duration = Duration::from_millis(200);

/// The number of steps between updates of a bar over steps that this process executes.
const STEPS_PER_UPDATE: u64 = 100;

/// The template of a bar over steps.
pub const STEPS: &str = "{prefix} {bar:20} {percent:>3}%  {wide_msg} {eta} left";

/// The length of a bar over a share.
pub const THOUSANDTHS: u64 = 1000;

/// The position of a share from 0 to 1 in a bar of [`THOUSANDTHS`].
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a share is from 0 to 1"
)]
pub fn thousandths(share: f64) -> u64 {
    (share * THOUSANDTHS as f64) as u64
}

/// A bar over `length`, or a spinner. Hidden with `--json`, and unless stderr is a terminal.
pub fn bar(output: Output, length: Option<u64>, template: &str, prefix: &str) -> ProgressBar {
    if output.json {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::with_draw_target(length, ProgressDrawTarget::stderr());
    bar.set_style(ProgressStyle::with_template(template).expect("a constant"));
    bar.set_prefix(prefix.to_owned());
    bar.enable_steady_tick(TICK);
    bar
}

/// Moves a bar over steps on; a step takes less time than that.
pub fn show_step(bar: &ProgressBar, step: u64) {
    if step.is_multiple_of(STEPS_PER_UPDATE) {
        bar.set_position(step);
    }
}
