//! The HTML file that plays and re-runs a run in a browser: the data in it, and its check on this machine.
//!
//! The file is the page of the player with three texts in it: its title, the data as JSON, and the module
//! that steps swarms, compressed and in base64. [`HtmlFile`] is that JSON.

use std::fmt::{self, Display};
use std::io::{self, Write as _};
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;
use jostle_physics::model::{MODEL_VERSION, State};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::error::PlanError;
use crate::files::{EncodedFiles, Files, disk};
use crate::plan::{Plan, PlannedRun};
use crate::run::execute_run_from;

pub use self::frames::{EncodedFrames, FrameEncoder, FrameOfBodies};
pub use self::module::{MAX_MODULE_BYTES, Module, ModuleError};

mod frames;
mod module;

/// The number of the format of the data; a reader rejects a larger one.
pub const FORMAT: u32 = 1;

/// What the page of the player begins with.
const GENERATOR: &str = "<meta name=\"generator\" content=\"jostle export\"";

/// The tag before the data.
const BEFORE_DATA: &str = "<script type=\"application/json\" id=\"jostle-file\">";

/// The tag after the data. The data do not contain it: [`json`] escapes `<`.
const AFTER_DATA: &str = "</script>";

/// The end of a whole file.
const END: &str = "</html>";

/// What the player's page contains in place of the texts, in this order.
const PLACES: [&str; 3] = ["{{jostle:title}}", "{{jostle:file}}", "{{jostle:module}}"];

/// The data of a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HtmlFile {
    /// The number of the format.
    pub format: u32,
    /// The name of the swarm, the experiment or the recording.
    pub name: String,
    /// The version of jostle that wrote the file.
    pub version: String,
    /// The version of the model that stepped the swarm.
    pub model_version: u32,
    /// The licences of what the module contains: base64 of gzip of their text, or empty.
    #[serde(default)]
    pub licences: String,
    /// What the file plays.
    #[serde(flatten)]
    pub content: Content,
}

/// What a file plays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Content {
    /// A run, which can be executed again.
    Run(Box<ClaimedRun>),
    /// The frames of a recording, which states no result.
    Recording {
        /// The frames.
        frames: EncodedFrames,
    },
}

/// A run of an experiment and the result that the file states.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClaimedRun {
    /// The files of the experiment.
    pub files: EncodedFiles,
    /// Which of its runs.
    pub run: RunOfPlan,
    /// How it ends.
    pub claim: Claim,
    /// Its frames, in a file without the module.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames: Option<EncodedFrames>,
}

/// A run of a plan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunOfPlan {
    /// Its index, from 0.
    pub index: usize,
    /// Its name.
    pub name: String,
}

/// How a run ends.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Claim {
    /// The number of its steps.
    pub steps: u64,
    /// The hash of its last state, in hexadecimal.
    pub state_hash: String,
    /// The fault that ended it early, if one did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<String>,
}

/// Why a text is no such file, or none can be made.
#[derive(Debug, Error)]
pub enum HtmlError {
    /// It cannot be read.
    #[error("{0}")]
    File(io::Error),
    /// It has no data.
    #[error("not a file of `jostle export`: it has no element jostle-file")]
    NoData,
    /// It ends early.
    #[error("the file ends early: copy it again")]
    Truncated,
    /// A later version wrote it.
    #[error(
        "the file has format {0}, and this version reads up to {FORMAT}: use the version that wrote it"
    )]
    Later(u32),
    /// Its data are damaged.
    #[error("the data of the file are damaged: {0}")]
    Damaged(String),
    /// The page of the player lacks a place.
    #[error("the page of the player does not have {0} exactly once")]
    NoPlace(&'static str),
}

/// Why a file cannot be checked.
#[derive(Debug, Error)]
pub enum CheckError {
    /// It is a recording.
    #[error("the file is a recording: it plays frames and states no result that could be checked")]
    NoClaim,
    /// Another version of the model stepped the swarm.
    #[error(
        "jostle {version} wrote the file, with version {model} of the model, and this one has version \
         {MODEL_VERSION}: open the file in a browser, or check it with jostle {version}"
    )]
    OtherModel {
        /// The version of jostle that wrote the file.
        version: String,
        /// Its version of the model.
        model: u32,
    },
    /// Its files are no experiment.
    #[error("the experiment in the file is invalid: {0}")]
    Plan(#[from] PlanError),
    /// Its data are damaged.
    #[error("the data of the file are damaged: {0}")]
    Damaged(String),
    /// The caller has ended the check.
    #[error("the check was cancelled")]
    Cancelled,
}

/// The result of a check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Checked {
    /// Whether the run ended as the file states.
    pub equal: bool,
    /// How it ended here; none if it took no step.
    pub found: Option<Claim>,
    /// How it ends according to the file.
    pub claim: Claim,
    /// Why it took no step.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// A file whose run is ready to be executed again.
#[derive(Debug)]
pub struct Check {
    plan: Plan,
    index: usize,
    claim: Claim,
}

impl HtmlFile {
    /// Returns the data of a file that this version writes, with the text of the licences.
    #[must_use]
    pub fn new(name: String, licences: &str, content: Content) -> Self {
        let licences = match licences {
            "" => String::new(),
            licences => packed(licences.as_bytes()),
        };
        Self {
            format: FORMAT,
            name,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            model_version: MODEL_VERSION,
            licences,
            content,
        }
    }

    /// Reads the data in a file.
    ///
    /// # Errors
    ///
    /// [`HtmlError`].
    pub fn read(path: &Path) -> Result<Self, HtmlError> {
        let bytes = disk::read(path).map_err(|error| HtmlError::File(error.source))?;
        // What is no UTF-8 is no such file, too.
        Self::parse(&String::from_utf8_lossy(&bytes))
    }

    /// Reads the data in the text of a file.
    ///
    /// # Errors
    ///
    /// [`HtmlError`].
    pub fn parse(html: &str) -> Result<Self, HtmlError> {
        let none = match html.contains(GENERATOR) {
            true => HtmlError::Truncated,
            false => HtmlError::NoData,
        };
        let (_, data) = html.split_once(BEFORE_DATA).ok_or(none)?;
        let (data, _) = data.split_once(AFTER_DATA).ok_or(HtmlError::Truncated)?;
        if !html.trim_end().ends_with(END) {
            return Err(HtmlError::Truncated);
        }
        let damaged = |error: serde_json::Error| HtmlError::Damaged(error.to_string());
        let value: serde_json::Value = serde_json::from_str(data).map_err(damaged)?;
        let format = value.get("format").and_then(serde_json::Value::as_u64);
        match format.map(|it| u32::try_from(it).unwrap_or(u32::MAX)) {
            Some(format) if format > FORMAT => Err(HtmlError::Later(format)),
            _ => serde_json::from_value(value).map_err(damaged),
        }
    }

    /// Returns the text of a file: the page of the player with the data in it, and the module.
    ///
    /// # Errors
    ///
    /// [`HtmlError::NoPlace`] if `player` is not the page of a player.
    pub fn fill(&self, player: &str, module: Option<&Module>) -> Result<String, HtmlError> {
        let data = json(self).map_err(|error| HtmlError::Damaged(error.to_string()))?;
        let module = module.map(Module::base64).unwrap_or_default();
        let (mut html, mut rest) = (String::new(), player);
        for (place, text) in PLACES.into_iter().zip([escaped(&self.name), data, module]) {
            let (before, after) = rest.split_once(place).ok_or(HtmlError::NoPlace(place))?;
            if before.contains("{{jostle:") || after.contains(place) {
                return Err(HtmlError::NoPlace(place));
            }
            html += before;
            html += &text;
            rest = after;
        }
        Ok(html + rest)
    }
}

/// Returns bytes compressed by gzip, in base64.
fn packed(bytes: &[u8]) -> String {
    let mut gzip = GzEncoder::new(Vec::new(), Compression::best());
    gzip.write_all(bytes).expect("memory takes it");
    STANDARD.encode(gzip.finish().expect("memory takes it"))
}

/// Returns JSON that no HTML parser takes for a tag.
fn json(file: &HtmlFile) -> serde_json::Result<String> {
    Ok(serde_json::to_string(file)?.replace('<', "\\u003c"))
}

/// Returns a text as HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

impl ClaimedRun {
    /// Returns a run that ends in this way.
    #[must_use]
    pub fn new(plan: &Plan, run: &PlannedRun, claim: Claim) -> Self {
        Self {
            files: plan.files.clone().into(),
            run: RunOfPlan {
                index: plan.index(&run.name).unwrap_or(0),
                name: run.name.clone(),
            },
            claim,
            frames: None,
        }
    }
}

impl Claim {
    /// Executes a run and returns how it ends, or why it took no step. `on_step` is called with the state
    /// after each step; if it returns false, the result is none.
    #[must_use]
    pub fn of(
        plan: &Plan,
        run: &PlannedRun,
        mut on_step: impl FnMut(&State) -> bool,
    ) -> Option<Result<Self, String>> {
        let finished = execute_run_from(plan, run, None, None, |current| {
            on_step(&current.simulation().state)
        })?;
        let fault = finished.fault;
        Some(match finished.row {
            Some(row) => Ok(Self {
                steps: row.steps,
                state_hash: row.state_hash,
                fault,
            }),
            None => Err(fault.unwrap_or_else(|| "it has no step".to_owned())),
        })
    }
}

impl Check {
    /// Prepares the check of a file.
    ///
    /// # Errors
    ///
    /// [`CheckError`].
    pub fn of(file: &HtmlFile) -> Result<Self, CheckError> {
        let Content::Run(run) = &file.content else {
            return Err(CheckError::NoClaim);
        };
        if file.model_version != MODEL_VERSION {
            return Err(CheckError::OtherModel {
                version: file.version.clone(),
                model: file.model_version,
            });
        }
        let files = Files::try_from(run.files.clone());
        let files = files.map_err(|error| CheckError::Damaged(error.to_string()))?;
        let plan = Plan::of(files)?;
        let RunOfPlan { index, name } = &run.run;
        if plan.runs().get(*index).is_none_or(|it| it.name != *name) {
            let number = index.saturating_add(1);
            let problem = format!("the experiment has no run {name:?} with the number {number}");
            return Err(CheckError::Damaged(problem));
        }
        Ok(Self {
            plan,
            index: *index,
            claim: run.claim.clone(),
        })
    }

    /// Returns the number of steps of the run, at most.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.plan.point(self.run()).steps
    }

    /// Executes the run and compares its end. `on_step` is called after each step, and ends the check by
    /// false.
    ///
    /// # Errors
    ///
    /// [`CheckError::Cancelled`].
    pub fn execute(self, mut on_step: impl FnMut(u64) -> bool) -> Result<Checked, CheckError> {
        let ended = Claim::of(&self.plan, self.run(), |state| on_step(state.step));
        let ended = ended.ok_or(CheckError::Cancelled)?;
        let (found, reason) = match ended {
            Ok(found) => (Some(found), None),
            Err(reason) => (None, Some(reason)),
        };
        let equal = found.as_ref() == Some(&self.claim);
        Ok(Checked {
            equal,
            found,
            claim: self.claim,
            reason,
        })
    }

    fn run(&self) -> &PlannedRun {
        &self.plan.runs()[self.index]
    }
}

/// `equal after 5,000 steps: 3f2a…`, or `different: …`.
impl Display for Checked {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.found, self.equal) {
            (Some(found), true) => write!(formatter, "equal {found}"),
            (Some(found), false) => write!(
                formatter,
                "different: the run ends {found}; the file states: {}",
                self.claim
            ),
            (None, _) => write!(
                formatter,
                "different: the run takes no step ({}); the file states: {}",
                self.reason.as_deref().unwrap_or_default(),
                self.claim
            ),
        }
    }
}

/// `after 5,000 steps: 3f2a…`.
impl Display for Claim {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let plural = if self.steps == 1 { "" } else { "s" };
        let (steps, hash) = (grouped(self.steps), &self.state_hash);
        write!(formatter, "after {steps} step{plural}: {hash}")?;
        match &self.fault {
            Some(fault) => write!(formatter, " (ended early: {fault})"),
            None => Ok(()),
        }
    }
}

/// Returns a number with a comma before each three digits.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests;
