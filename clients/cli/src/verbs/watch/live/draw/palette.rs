//! Colours, or text attributes where there are none.

use jostle_proto::Phase;
use ratatui::style::{Color, Modifier, Style};

/// Styles. The colours are the terminal's own, so that they suit its background.
#[derive(Clone, Copy, Debug)]
pub struct Palette {
    /// Whether to use colours.
    pub is_coloured: bool,
}

impl Palette {
    /// Honours `NO_COLOR`, see <https://no-color.org>.
    pub fn of_the_environment() -> Self {
        Palette {
            is_coloured: std::env::var_os("NO_COLOR").is_none_or(|it| it.is_empty()),
        }
    }

    fn colour(self, colour: Color) -> Color {
        if self.is_coloured {
            colour
        } else {
            Color::Reset
        }
    }

    pub fn body(self) -> Color {
        self.colour(Color::Cyan)
    }

    /// Informed bodies, and the drift.
    pub fn informed(self) -> Color {
        self.colour(Color::Magenta)
    }

    /// The heads of bodies, in the colour of text.
    pub fn head(self) -> Color {
        Color::Reset
    }

    /// The direction of informed bodies.
    pub fn direction(self) -> Color {
        self.colour(Color::Yellow)
    }

    /// The grid of marks behind the bodies.
    pub fn grid(self) -> Color {
        self.colour(Color::DarkGray)
    }

    /// Frames, and the names of numbers.
    pub fn faint(self) -> Style {
        if self.is_coloured {
            Style::new().fg(Color::DarkGray)
        } else {
            Style::new().add_modifier(Modifier::DIM)
        }
    }

    pub fn strong(self) -> Style {
        Style::new().add_modifier(Modifier::BOLD)
    }

    pub fn selected(self) -> Style {
        Style::new().add_modifier(Modifier::REVERSED)
    }

    pub fn error(self) -> Style {
        if self.is_coloured {
            Style::new().fg(Color::Red).add_modifier(Modifier::BOLD)
        } else {
            Style::new().add_modifier(Modifier::BOLD | Modifier::REVERSED)
        }
    }

    pub fn phase(self, phase: Phase) -> Style {
        match phase {
            Phase::Running => Style::new().fg(self.colour(Color::Green)),
            Phase::Paused => Style::new().fg(self.colour(Color::Yellow)),
            Phase::Faulted => self.error(),
        }
    }
}

/// A phase in one character.
pub fn glyph(phase: Phase) -> &'static str {
    match phase {
        Phase::Running => "▶",
        Phase::Paused => "‖",
        Phase::Faulted => "✗",
    }
}
