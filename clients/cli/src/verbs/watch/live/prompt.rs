//! The prompt of `inform`: which individuals, direction, weight.

use jostle_proto::verbs::{InformArgs, Select};
use ratatui::crossterm::event::{KeyCode, KeyEvent};

use super::chord::is_chord;
use crate::values;

/// The fields, each with the form of its text.
pub const FIELDS: [(&str, &str); 3] = [
    ("who", "a count, 5, or a share, 0.1 or 10%"),
    ("direction", "90d or 1.57 from +x, counter-clockwise"),
    ("weight", "empty: the swarm's pi2"),
];
/// The longest text, in characters.
const MAX_LENGTH: usize = 24;

/// The state of the prompt.
#[derive(Clone, Debug, PartialEq)]
pub struct Prompt {
    /// The swarm that it was opened for: another may be selected meanwhile, since this one is gone.
    pub swarm: String,
    /// The texts of the fields.
    pub texts: [String; 3],
    /// The index of the current field.
    pub at: usize,
    /// What is wrong with a field.
    pub problem: Option<String>,
}

/// The effect of a key on the prompt.
#[derive(Debug, PartialEq)]
pub enum KeyAction {
    /// It stays open.
    Open,
    /// It was cancelled.
    Cancelled,
    /// All fields are filled in, for this swarm.
    Submitted(String, InformArgs),
}

impl Prompt {
    pub fn of(swarm: String) -> Self {
        Prompt {
            swarm,
            texts: ["10%".into(), "0d".into(), String::new()],
            at: 0,
            problem: None,
        }
    }

    /// Handles a key.
    pub fn press(&mut self, key: KeyEvent) -> KeyAction {
        self.problem = None;
        let last = FIELDS.len() - 1;
        match key.code {
            KeyCode::Esc => return KeyAction::Cancelled,
            KeyCode::Enter if self.at == last => match self.read() {
                Ok(args) => return KeyAction::Submitted(self.swarm.clone(), args),
                Err((at, problem)) => {
                    self.at = at;
                    self.problem = Some(problem);
                }
            },
            KeyCode::Enter | KeyCode::Tab | KeyCode::Down => self.at = (self.at + 1).min(last),
            KeyCode::BackTab | KeyCode::Up => self.at = self.at.saturating_sub(1),
            KeyCode::Backspace => drop(self.texts[self.at].pop()),
            KeyCode::Char(typed) if !is_chord(key) => self.insert(&typed.to_string()),
            _ => {}
        }
        KeyAction::Open
    }

    /// Appends what was typed or pasted to the current field.
    pub fn insert(&mut self, text: &str) {
        let field = &mut self.texts[self.at];
        let room = MAX_LENGTH.saturating_sub(field.chars().count());
        field.extend(text.chars().filter(|it| !it.is_control()).take(room));
    }

    /// Parses the fields; an error has the index of the field.
    fn read(&self) -> Result<InformArgs, (usize, String)> {
        let [who, direction, weight] = &self.texts;
        let weight = match weight.trim() {
            "" => Ok(None),
            weight => values::number(weight).map(Some),
        };
        Ok(InformArgs {
            select: select(who).map_err(|it| (0, it))?,
            direction: radians(direction).map_err(|it| (1, it))?,
            weight: weight.map_err(|it| (2, it))?,
            for_time: None,
        })
    }
}

/// `5` is a count, `0.1` and `10%` are shares.
fn select(text: &str) -> Result<Select, String> {
    let text = text.trim();
    if let Some(percent) = text.strip_suffix('%') {
        return values::number(percent).map(|it| Select::Fraction(it / 100.0));
    }
    match text.parse() {
        Ok(count) => Ok(Select::Count(count)),
        Err(_) => values::number(text).map(Select::Fraction),
    }
}

/// `90d`, `90deg` and `90°` are degrees, `1.57` is radians.
fn radians(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let radians = text.strip_suffix("rad");
    let degrees = ["°", "deg", "d"]
        .iter()
        .find_map(|it| text.strip_suffix(it));
    if let (None, Some(degrees)) = (radians, degrees) {
        return values::number(degrees).map(f64::to_radians);
    }
    let radians = values::number(radians.unwrap_or(text))?;
    // More than a turn is most likely meant in degrees.
    if radians.abs() > std::f64::consts::TAU {
        return Err(format!("more than a turn: degrees are written {radians}d"));
    }
    Ok(radians)
}

#[cfg(test)]
mod tests {
    use ratatui::crossterm::event::KeyModifiers;

    use super::*;

    fn filled(texts: [&str; 3]) -> Result<InformArgs, (usize, String)> {
        Prompt {
            texts: texts.map(Into::into),
            ..Prompt::of("demo".into())
        }
        .read()
    }

    #[test]
    fn counts_shares_degrees_and_radians_are_distinguished() {
        let args = |select, direction, weight| {
            Ok(InformArgs {
                select,
                direction,
                weight,
                for_time: None,
            })
        };
        assert_eq!(filled(["5", "0", ""]), args(Select::Count(5), 0.0, None));
        let up = 90.0_f64.to_radians();
        for degrees in ["90d", " 90° ", "90deg"] {
            let expected = args(Select::Fraction(0.1), up, Some(2.0));
            assert_eq!(filled(["10%", degrees, "2"]), expected);
            assert_eq!(filled(["0.1", degrees, " 2"]), expected);
        }
        assert_eq!(
            filled(["1.0", "-1.5rad", ""]),
            args(Select::Fraction(1.0), -1.5, None)
        );
    }

    #[test]
    fn an_error_names_the_field_it_is_in() {
        let wrong = |texts| filled(texts).map_err(|(at, _)| at);
        assert_eq!(wrong(["", "0", ""]), Err(0));
        assert_eq!(wrong(["five", "0", ""]), Err(0));
        assert_eq!(wrong(["5", "90", ""]), Err(1), "radians by far too many");
        assert_eq!(wrong(["5", "", ""]), Err(1));
        assert_eq!(wrong(["5", "0", "x"]), Err(2));
    }

    #[test]
    fn keys_edit_submit_and_cancel() {
        let mut prompt = Prompt::of("demo".into());
        let mut press = |code| prompt.press(KeyEvent::new(code, KeyModifiers::NONE));
        for _ in 0..3 {
            press(KeyCode::Backspace);
        }
        press(KeyCode::Char('7'));
        press(KeyCode::Enter);
        press(KeyCode::Tab);
        let KeyAction::Submitted(_, args) = press(KeyCode::Enter) else {
            panic!("it is submitted");
        };
        assert_eq!(args.select, Select::Count(7));
        assert_eq!(press(KeyCode::Esc), KeyAction::Cancelled);
    }
}
