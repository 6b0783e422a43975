//! Reads the files that an experiment's file names.

use toml::Spanned;

use super::Plan;
use crate::error::PlanError;
use crate::file::{File, Source};
use crate::files::{Files, shown};
use crate::points::Points;
use crate::start::Base;

impl Plan {
    /// Returns the earliest version of the model that computed a part of the snapshot from which every run
    /// starts, if it is before this program's.
    #[must_use]
    pub fn start_model_version(&self) -> Option<u32> {
        self.base.as_ref()?.earlier_model()
    }
}

/// Reads the CSV that the file names; none if it names none.
pub fn points(source: Source<'_>, file: &File, files: &Files) -> Result<Option<Points>, PlanError> {
    let reason = match (&file.points, &files.points) {
        (Some(named), Some(text)) if file.grid.is_empty() => {
            let name = named.get_ref();
            return Points::read(name, text, source.toml.len() + 1).map(Some);
        }
        (Some(_), _) if !file.grid.is_empty() => {
            "points and [[grid]] exclude each other: leave out one of them"
        }
        (Some(_), _) => {
            "points: the contents of this file are missing: submit the experiment with a client of \
             this version"
        }
        (None, Some(_)) => "a CSV was sent, but the file names none: give points",
        (None, None) => return Ok(None),
    };
    let span = file.points.as_ref().map_or(0..0, Spanned::span);
    Err(source.reject(&span, reason))
}

/// Reads the snapshot that the file names; none if it names none.
pub fn base(source: Source<'_>, file: &File, files: &Files) -> Result<Option<Base>, PlanError> {
    let span = file.start.as_ref().map_or(0..0, Spanned::span);
    let reason = match (&file.start, &files.start) {
        (Some(named), Some(bytes)) => match Base::read(bytes) {
            Ok(base) => return Ok(Some(base)),
            Err(reason) => {
                let name = named.get_ref();
                format!("{name}: {}", shown(name, reason))
            }
        },
        (Some(_), None) => {
            "start: the contents of this file are missing: submit the experiment with a \
             client of this version"
                .to_owned()
        }
        (None, Some(_)) => "a snapshot was sent, but the file names none: give start".to_owned(),
        (None, None) => return Ok(None),
    };
    Err(source.reject(&span, reason))
}
