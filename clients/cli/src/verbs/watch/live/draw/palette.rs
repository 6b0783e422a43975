//! Colours where the terminal has them, and what stands for them where it has not.

use jostle_proto::Phase;
use ratatui::style::{Color, Modifier, Style};

/// How things look. The colours are the terminal's own, so that they suit its background.
#[derive(Clone, Copy, Debug)]
pub struct Palette {
    /// Whether there are colours.
    pub is_coloured: bool,
}

impl Palette {
    /// As <https://no-color.org> has it.
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

    /// Bodies that only follow.
    pub fn body(self) -> Color {
        self.colour(Color::Cyan)
    }

    /// Bodies with a direction of their own, and how the group follows them.
    pub fn informed(self) -> Color {
        self.colour(Color::Magenta)
    }

    /// The heads of bodies, as text is written.
    pub fn head(self) -> Color {
        Color::Reset
    }

    /// That direction.
    pub fn direction(self) -> Color {
        self.colour(Color::Yellow)
    }

    /// The ground the bodies move on.
    pub fn ground(self) -> Color {
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

    /// What counts.
    pub fn strong(self) -> Style {
        Style::new().add_modifier(Modifier::BOLD)
    }

    /// What is chosen.
    pub fn chosen(self) -> Style {
        Style::new().add_modifier(Modifier::REVERSED)
    }

    /// What went wrong.
    pub fn error(self) -> Style {
        if self.is_coloured {
            Style::new().fg(Color::Red).add_modifier(Modifier::BOLD)
        } else {
            Style::new().add_modifier(Modifier::BOLD | Modifier::REVERSED)
        }
    }

    /// What a swarm is doing.
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
