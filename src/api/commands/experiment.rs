//! `experiment`: submits, pauses, resumes, cancels and deletes experiments.

use jostle_proto::{ExperimentArgs, ExperimentResult, NodeReply};

use crate::api::context::{Context, Parsed};
use crate::convert::commands::{CommandError, check_name};
use crate::convert::{self, Payload};

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
                    experiments.submit(args.name.as_deref(), &args.toml)
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
