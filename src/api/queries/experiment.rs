//! `progress`, `results`, `order` and `series` of experiments.

use std::time::Duration;

use jostle_experiment::SeriesKind;
use jostle_proto::{Experiments, keys};

use crate::api::context::Context;
use crate::api::incoming::{Incoming, page, page_of_run, page_of_series};
use crate::api::responder::Responder;
use crate::convert::commands::{CommandError, truncate};
use crate::convert::{self, Payload};
use crate::experiments::{ExperimentManager, Report};
use crate::lanes::Lane;

/// The longest read that a client waits for.
const READ_TIMEOUT: Duration = Duration::from_secs(60);

/// The most bytes of the rows of a page, so that a reply fits one message.
const MAX_PAGE_BYTES: usize = 768 * 1024;

/// The most numbers of a page of measures over time, so that a reply fits one message.
const MAX_VALUES: usize = 100_000;

/// The columns of a trajectory.
const TRAJECTORY_COLUMNS: usize = 7;

impl Context {
    /// All experiments and their progress.
    pub(super) fn experiments(&self) -> Experiments {
        let reports = self.experiments.reports().into_iter();
        Experiments {
            experiments: reports.map(convert::progress).collect(),
        }
    }

    /// Replies to a query of one experiment; a wildcard matches `progress` alone.
    pub(crate) fn experiment_get(&self, incoming: &Incoming) {
        if incoming.is_wild {
            for report in self.experiments.reports() {
                let key = keys::experiment(&self.prefix, &self.node, &report.name, "progress");
                if incoming.peer.matches(&key) {
                    let responder = self.replies.responder(incoming, key);
                    if let Err(error) = progress(incoming, &responder, report) {
                        responder.reject(&error, None);
                    }
                }
            }
            return;
        }
        let responder = self.responder(incoming);
        let prefix = keys::experiment(&self.prefix, &self.node, "", "");
        let below = incoming.key.strip_prefix(prefix.trim_end_matches('/'));
        let (name, noun) = below
            .and_then(|below| below.trim_start_matches('/').split_once('/'))
            .unwrap_or_default();
        let done = match noun {
            "progress" => match self.experiments.report(name) {
                Ok(report) => progress(incoming, &responder, report),
                Err(error) => Err(error.into()),
            },
            "results" => self.results(incoming, &responder, name),
            "order" => self.order(incoming, &responder, name),
            "series" => self.series(incoming, &responder, name),
            _ => Err(CommandError::UnknownNoun {
                noun: truncate(noun),
                known: &keys::EXPERIMENT_GETS,
            }),
        };
        if let Err(error) = done {
            responder.reject(&error, None);
        }
    }

    /// Queues a read of an experiment's files.
    fn read_experiment(
        &self,
        incoming: &Incoming,
        responder: &Responder,
        name: &str,
        read: impl FnOnce(&ExperimentManager, &Responder) + Send + 'static,
    ) -> Result<(), CommandError> {
        responder.set_deadline(READ_TIMEOUT, CommandError::read_deadline, None);
        let turn = self.turn(incoming, name);
        let (experiments, reader) = (self.experiments.clone(), responder.clone());
        self.queue_read(Lane::Files, &turn, responder, move || {
            read(&experiments, &reader);
        })
    }

    fn results(
        &self,
        incoming: &Incoming,
        responder: &Responder,
        name: &str,
    ) -> Result<(), CommandError> {
        let (after, limit) = page(incoming.parameters())?;
        let name = name.to_owned();
        self.read_experiment(
            incoming,
            responder,
            &name.clone(),
            move |experiments, responder| {
                let read = experiments
                    .report(&name)
                    .and_then(|report| Ok((report, experiments.rows(&name)?)));
                responder.finish(read, move |(report, (columns, rows))| {
                    let finished = report.progress.finished as u64;
                    let begin = rows.partition_point(|(number, _)| *number <= after);
                    let rows = &rows[begin..];
                    let page = convert::results_page(
                        name,
                        &columns,
                        rows,
                        limit,
                        MAX_PAGE_BYTES,
                        finished,
                    );
                    Payload::json(&page)
                });
            },
        )
    }

    fn order(
        &self,
        incoming: &Incoming,
        responder: &Responder,
        name: &str,
    ) -> Result<(), CommandError> {
        let (run, after, limit) = page_of_run(incoming.parameters())?;
        let (name, run) = (name.to_owned(), run.to_owned());
        self.read_experiment(
            incoming,
            responder,
            &name.clone(),
            move |experiments, responder| {
                let page = (after, limit, usize::MAX);
                let part = experiments.series(SeriesKind::Order, (&name, &run), page);
                responder.finish(part, move |part| {
                    Payload::cbor(&convert::order_page(name, after, part))
                });
            },
        )
    }

    fn series(
        &self,
        incoming: &Incoming,
        responder: &Responder,
        name: &str,
    ) -> Result<(), CommandError> {
        let (page, is_trajectory) = page_of_series(incoming.parameters())?;
        let (run, after, limit) = page;
        let (name, run) = (name.to_owned(), run.to_owned());
        self.read_experiment(
            incoming,
            responder,
            &name.clone(),
            move |experiments, responder| {
                if is_trajectory {
                    let limit = limit.min(MAX_VALUES / TRAJECTORY_COLUMNS);
                    let rows = experiments.trajectory(&name, &run, after, limit);
                    return responder.finish(rows, move |rows| {
                        Payload::cbor(&convert::trajectory_page(name, run, after, rows))
                    });
                }
                let page = (after, limit, MAX_VALUES);
                let part = experiments.series(SeriesKind::Measures, (&name, &run), page);
                responder.finish(part, move |part| {
                    Payload::cbor(&convert::series_page(name, after, part))
                });
            },
        )
    }
}

fn progress(
    incoming: &Incoming,
    responder: &Responder,
    report: Report,
) -> Result<(), CommandError> {
    incoming.no_parameters()?;
    responder.complete(move || Ok(Payload::json(&convert::progress(report))));
    Ok(())
}
