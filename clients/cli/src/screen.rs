//! Lines on a terminal that are redrawn in place.

use crate::failure::Failure;
use crate::output;

/// Control sequences. Long lines are cut rather than wrapped, since the cursor moves up by the number
/// of lines.
const DO_NOT_WRAP: &str = "\x1b[?7l";
const WRAP: &str = "\x1b[?7h";
const CLEAR_LINE: &str = "\x1b[K";
const CLEAR_BELOW: &str = "\x1b[J";

/// The number of lines drawn last.
#[derive(Debug, Default)]
pub struct Screen {
    drawn: usize,
}

impl Screen {
    /// Draws a text and a line below it over what was drawn before. The cursor stays below, where
    /// an echoed ^C does no harm.
    pub fn draw(&mut self, text: &str, below: Option<&str>) -> Result<(), Failure> {
        let (height, width) = console::Term::stdout().size();
        let lines = lines_that_fit(text, below, usize::from(height), usize::from(width));
        let mut screen = String::from("\r");
        if self.drawn > 0 {
            screen.push_str(&format!("\x1b[{}A", self.drawn));
        }
        screen.push_str(DO_NOT_WRAP);
        for line in &lines {
            screen.push_str(&format!("{line}{CLEAR_LINE}\n"));
        }
        screen.push_str(CLEAR_BELOW);
        screen.push_str(WRAP);
        self.drawn = lines.len();
        output::write(&screen)
    }
}

/// The lines that fit above the cursor, cut at the width of the terminal: without wrapping a terminal
/// shows the end of a long line in its last column.
fn lines_that_fit(text: &str, below: Option<&str>, height: usize, width: usize) -> Vec<String> {
    let room = height
        .saturating_sub(1 + usize::from(below.is_some()))
        .max(1);
    let count = text.lines().count();
    let shown = if count > room { room - 1 } else { count };
    let left_out = (count > shown).then(|| format!("… {} more lines", count - shown));
    text.lines()
        .take(shown)
        .chain(left_out.as_deref())
        .chain(below)
        .map(|line| console::truncate_str(line, width, "…").into_owned())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_that_do_not_fit_are_cut_and_counted() {
        assert_eq!(lines_that_fit("a\nb", None, 24, 80), ["a", "b"]);
        assert_eq!(lines_that_fit("a\nb", Some("c"), 24, 80), ["a", "b", "c"]);
        assert_eq!(
            lines_that_fit("a\nb\nc\nd", None, 4, 80),
            ["a", "b", "… 2 more lines"]
        );
        assert_eq!(lines_that_fit("a\nb", None, 3, 80), ["a", "b"]);
        assert_eq!(lines_that_fit("abcdef", None, 24, 4), ["abc…"]);
        assert_eq!(
            lines_that_fit("a\nb", Some("c"), 0, 80),
            ["… 2 more lines", "c"]
        );
    }
}
