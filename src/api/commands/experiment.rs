//! `experiment`: submits, pauses, resumes, cancels and deletes experiments.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_experiment::Files;
use jostle_proto::{ExperimentArgs, ExperimentResult, NodeReply, SubmitArgs};

use crate::api::context::{Context, Parsed};
use crate::convert::commands::{CommandError, check_name};
use crate::convert::{self, Payload};
use crate::experiments::ExperimentError;

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
        };
        if let Some(name) = name {
            let checked = check_name("name", name);
            checked.map_err(|error| error.within(action.to_owned()))?;
        }
        let (node, responder) = (self.node.clone(), command.responder.clone());
        self.experiment_files.submit(move |experiments| {
            let done = match &args {
                ExperimentArgs::Submit(args) => {
                    let SubmitArgs {
                        toml,
                        points,
                        start,
                        name,
                    } = args.clone();
                    match start.map(|it| STANDARD.decode(it)).transpose() {
                        Ok(start) => {
                            let files = Files {
                                toml,
                                points,
                                start,
                            };
                            experiments.submit(name.as_deref(), files)
                        }
                        Err(error) => Err(ExperimentError::Plan {
                            reason: format!("start is no base64: {error}"),
                            field: "submit.start",
                            line: None,
                        }),
                    }
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
            };
            responder.finish(done, move |(created, report)| {
                let progress = convert::progress(report);
                let result = ExperimentResult { created, progress };
                Payload::json(&NodeReply { node, result })
            });
        });
        Ok(())
    }
}
