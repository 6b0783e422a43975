//! `experiment`: submits, pauses, resumes, cancels and deletes experiments.

use jostle_experiment::{EncodedFiles, Files, LiveRun, Plan, PlayError};
use jostle_proto::{ExpandArgs, ExperimentArgs, ExperimentResult, NodeReply, SubmitArgs};
use tracing::info;

use crate::api::context::{Context, Parsed};
use crate::convert::commands::{CommandError, check_name};
use crate::convert::{self, Payload};
use crate::experiments::ExperimentError;
use crate::lanes::Lane;

/// The most bytes of a reply around its result.
const ENVELOPE_BYTES: usize = 1024;

impl Context {
    pub(super) fn experiment(
        &self,
        command: &Parsed<'_>,
        args: ExperimentArgs,
    ) -> Result<(), CommandError> {
        let (action, name) = match &args {
            ExperimentArgs::Submit(args) => ("submit", args.name.as_deref()),
            ExperimentArgs::Pause(args) => ("pause", Some(args.name.as_str())),
            ExperimentArgs::Resume(args) => ("resume", Some(args.name.as_str())),
            ExperimentArgs::Cancel(args) => ("cancel", Some(args.name.as_str())),
            ExperimentArgs::Delete(args) => ("delete", Some(args.name.as_str())),
            ExperimentArgs::Expand(_) => ("expand", None),
        };
        if let Some(name) = name {
            let checked = check_name("name", name);
            checked.map_err(|error| error.within(action.to_owned()))?;
        }
        let (node, responder) = (self.node.clone(), command.responder.clone());
        let max_bytes = self.max_message_bytes;
        let args = match args {
            ExperimentArgs::Expand(args) => {
                // It changes nothing.
                return self.queue_read(
                    Lane::Files,
                    &command.turn,
                    &responder.clone(),
                    move || {
                        let expanded = expand(args, max_bytes);
                        responder.finish(expanded, move |result| {
                            Payload::json(&NodeReply { node, result })
                        });
                    },
                );
            }
            args => args,
        };
        let experiments = self.experiments.clone();
        let client = command.request.client.clone();
        self.queue_command(Lane::Experiments, &command.turn, move || {
            let done = match &args {
                ExperimentArgs::Submit(args) => {
                    let SubmitArgs {
                        toml,
                        points,
                        start,
                        setpoints,
                        name,
                        again,
                    } = args.clone();
                    let files = EncodedFiles {
                        toml,
                        points,
                        start,
                        setpoints,
                    };
                    let files = self::files("submit", files);
                    files.and_then(|files| experiments.submit(name.as_deref(), files, again))
                }
                ExperimentArgs::Pause(args) => experiments.pause(&args.name).map(|it| (false, it)),
                ExperimentArgs::Resume(args) => {
                    experiments.resume(&args.name).map(|it| (false, it))
                }
                ExperimentArgs::Cancel(args) => {
                    experiments.cancel(&args.name).map(|it| (false, it))
                }
                ExperimentArgs::Delete(args) => {
                    experiments.delete(&args.name).map(|it| (false, it))
                }
                // Queued above.
                ExperimentArgs::Expand(_) => return,
            };
            if let Ok((_, report)) = &done {
                info!(experiment = report.name, client, action, "executed");
            }
            responder.finish(done, move |(created, report)| {
                let result = ExperimentResult {
                    created,
                    progress: convert::progress(report),
                    expanded: None,
                };
                Payload::json(&NodeReply { node, result })
            });
        })
    }
}

/// Returns the files in the arguments of an action.
fn files(action: &str, files: EncodedFiles) -> Result<Files, ExperimentError> {
    Files::try_from(files).map_err(|error| ExperimentError::Plan {
        reason: format!("start is no base64: {error}"),
        field: format!("{action}.start"),
        line: None,
    })
}

/// Returns a run of a plan as the swarm and the commands that have its states, in at most `max_bytes`
/// of JSON.
fn expand(args: ExpandArgs, max_bytes: usize) -> Result<ExperimentResult, ExperimentError> {
    let ExpandArgs {
        toml,
        points,
        start,
        setpoints,
        run,
    } = args;
    let files = EncodedFiles {
        toml,
        points,
        start,
        setpoints,
    };
    let files = self::files("expand", files)?;
    let plan = Plan::of(files).map_err(|error| ExperimentError::of_plan("expand", &error))?;
    let reject = |field: &str, reason: String| ExperimentError::Plan {
        reason,
        field: format!("expand.{field}"),
        line: None,
    };
    let found = match &run {
        None => plan.runs().first(),
        Some(run) => plan.find(run),
    };
    let found = found.ok_or_else(|| {
        let (run, runs) = (run.unwrap_or_default(), plan.runs().len());
        let reason = format!(
            "there is no run {run:?}: give a number from 1 to {runs} or a name, as `jostled run FILE \
             --dry-run` lists them"
        );
        reject("run", reason)
    })?;
    let live = LiveRun::new(&plan, found).map_err(|error| match error {
        PlayError::TooMany => ExperimentError::TooLong(error.to_string()),
        error => reject("toml", error.to_string()),
    })?;
    let result = ExperimentResult {
        created: false,
        progress: convert::planned(&plan),
        expanded: Some(convert::expanded(&found.name, live)),
    };
    let bytes = Payload::json(&result).bytes.len();
    if bytes.saturating_add(ENVELOPE_BYTES) > max_bytes {
        let problem = format!(
            "the run has {bytes} bytes with its snapshot and commands, more than a message: execute it \
             with `jostle experiment run`"
        );
        return Err(ExperimentError::TooLong(problem));
    }
    Ok(result)
}
