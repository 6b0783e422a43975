//! Experiments on the bus: what is to be done with them, how far they are, what came of them.
//!
//! Reading and writing files takes as long as it takes: a thread of its own does it, in order.

use std::collections::BTreeMap;
use std::sync::mpsc::{Sender, channel};
use std::thread;
use std::time::Duration;

use jostle_proto::{ExperimentArgs, ExperimentResult, Experiments, JSON, NodeReply, Request, keys};
use tracing::warn;
use zenoh::qos::CongestionControl;
use zenoh::query::Query;
use zenoh::{Session, Wait};

use crate::api::commands::{self, CommandError, check_name};
use crate::api::context::Clerk;
use crate::api::copies::refuse_when;
use crate::api::pagination;
use crate::api::responder::{Asked, Keeper, Promise};
use crate::convert::{self, Payload};
use crate::experiments::{Lab, Report};
use crate::transport::zenoh::query::{names, no_parameters};

/// The least time between two publications of one experiment's progress.
const BETWEEN: Duration = Duration::from_millis(500);

/// How much a page of results may take, in bytes, so that the answer fits one message.
const MOST_BYTES_OF_ROWS: usize = 768 * 1024;

/// How many entries of an order over time an answer holds, unless told otherwise and at most.
const MOST_ENTRIES: usize = 40_000;

/// Something to be done with what is kept on the disk.
type Errand<T> = Box<dyn FnOnce(&T) + Send>;

/// Hands in what is to be done with what is kept on the disk: experiments, or recordings.
pub struct Errands<T>(Sender<Errand<T>>);

impl<T> Clone for Errands<T> {
    fn clone(&self) -> Self {
        Errands(self.0.clone())
    }
}

impl<T: Send + 'static> Errands<T> {
    /// Starts the thread that does it, until the last of these is dropped.
    ///
    /// # Errors
    ///
    /// When no thread can be started.
    pub fn start(name: &str, kept: T) -> std::io::Result<Self> {
        let (errands, handed_in) = channel::<Errand<T>>();
        thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || {
                while let Ok(errand) = handed_in.recv() {
                    errand(&kept);
                }
            })?;
        Ok(Errands(errands))
    }

    /// Has something done in its turn. What is owed is refused if it panics or never comes.
    pub(crate) fn hand_in(
        &self,
        promise: &Promise,
        errand: impl FnOnce(&T, Keeper) + Send + 'static,
    ) {
        let keeper = Keeper::new(promise.clone());
        self.run(move |kept| errand(kept, keeper));
    }

    /// Has something done in its turn that nobody waits for.
    pub(crate) fn run(&self, errand: impl FnOnce(&T) + Send + 'static) {
        // Once the thread has ended the daemon is going.
        let _ = self.0.send(Box::new(move |kept| {
            let work = std::panic::AssertUnwindSafe(|| errand(kept));
            if std::panic::catch_unwind(work).is_err() {
                warn!("a defect: what was to be done panicked");
            }
        }));
    }
}

impl Clerk {
    /// Does what is asked for with an experiment.
    pub(crate) fn experiment(
        &self,
        promise: &Promise,
        request: &Request,
    ) -> Result<(), CommandError> {
        refuse_when(request)?;
        commands::sender("experiment", request)?;
        let args: ExperimentArgs = request.args()?;
        let (verb, name) = match &args {
            ExperimentArgs::Submit(args) => ("submit", args.name.as_deref()),
            ExperimentArgs::Pause(args) => ("pause", Some(args.name.as_str())),
            ExperimentArgs::Resume(args) => ("resume", Some(args.name.as_str())),
            ExperimentArgs::Cancel(args) => ("cancel", Some(args.name.as_str())),
            ExperimentArgs::Delete(args) => ("delete", Some(args.name.as_str())),
        };
        if let Some(name) = name {
            let checked = check_name("name", name);
            checked.map_err(|error| error.within(verb.to_owned()))?;
        }
        let timeout = commands::timeout(request)?;
        let key = keys::node_cmd(&self.prefix, &self.node, "experiment");
        let is_new = self.enter(&key, request, promise)?;
        promise.keep_within(timeout, CommandError::deadline, || None);
        if !is_new {
            return Ok(());
        }
        let node = self.node.clone();
        self.errands.hand_in(promise, move |lab, keeper| {
            let done = match &args {
                ExperimentArgs::Submit(args) => lab.submit(args.name.as_deref(), &args.toml),
                ExperimentArgs::Pause(args) => lab.pause(&args.name).map(|it| (false, it)),
                ExperimentArgs::Resume(args) => lab.resume(&args.name).map(|it| (false, it)),
                ExperimentArgs::Cancel(args) => lab.cancel(&args.name).map(|it| (false, it)),
                ExperimentArgs::Delete(args) => lab.delete(&args.name).map(|it| (false, it)),
            };
            match done {
                Ok((created, report)) => keeper.leave().fulfil(move || {
                    let progress = convert::progress(report);
                    let result = ExperimentResult { created, progress };
                    Ok(Payload::json(&NodeReply { node, result }))
                }),
                Err(error) => keeper.leave().refuse(&error.into(), None),
            }
        });
        Ok(())
    }

    /// Every experiment, and how far it is.
    pub(crate) fn experiments(&self) -> Payload {
        let reports = self.lab.reports().into_iter();
        Payload::json(&NodeReply {
            node: self.node.clone(),
            result: Experiments {
                experiments: reports.map(convert::progress).collect(),
            },
        })
    }

    /// Answers what is asked of experiments: progress to wildcards too, the rest of one at a time.
    pub(crate) fn experiment_get(&self, asked: &Asked) {
        let query = &asked.query;
        let key = query.key_expr().as_str().to_owned();
        if query.key_expr().is_wild() {
            for report in self.lab.reports() {
                let key = keys::experiment(&self.prefix, &self.node, &report.name, "progress");
                if names(query, &key) {
                    self.progress(&self.desk.promise(asked, key), query, report);
                }
            }
            return;
        }
        let promise = self.desk.promise(asked, key.clone());
        let below = keys::experiment(&self.prefix, &self.node, "", "");
        let below = key.strip_prefix(below.trim_end_matches('/'));
        let (name, noun) = below
            .and_then(|below| below.trim_start_matches('/').split_once('/'))
            .unwrap_or_default();
        let read = match noun {
            "progress" => match self.lab.report(name) {
                Ok(report) => return self.progress(&promise, query, report),
                Err(error) => Err(error.into()),
            },
            "results" => self.results(&promise, query, name),
            "order" => self.order(&promise, query, name),
            _ => Err(CommandError::UnknownNoun {
                noun: commands::shortened(noun),
                known: &keys::EXPERIMENT_GETS,
            }),
        };
        if let Err(error) = read {
            promise.refuse(&error, None);
        }
    }

    fn progress(&self, promise: &Promise, query: &Query, report: Report) {
        match no_parameters(query) {
            Ok(()) => promise.keep(move || Ok(Payload::json(&convert::progress(report)))),
            Err(error) => promise.refuse(&error, None),
        }
    }

    fn results(&self, promise: &Promise, query: &Query, name: &str) -> Result<(), CommandError> {
        let (after, limit) = pagination::read(query.parameters().iter())?;
        let name = name.to_owned();
        self.errands.hand_in(promise, move |lab, keeper| {
            let read = lab
                .report(&name)
                .and_then(|report| Ok((report, lab.rows(&name)?)));
            match read {
                Ok((report, rows)) => keeper.leave().keep(move || {
                    let finished = report.progress.finished as u64;
                    let begin = rows.partition_point(|(number, _)| *number <= after);
                    let rows = &rows[begin..];
                    let page =
                        convert::results_page(name, rows, limit, MOST_BYTES_OF_ROWS, finished);
                    Ok(Payload::json(&page))
                }),
                Err(error) => keeper.leave().refuse(&error.into(), None),
            }
        });
        Ok(())
    }

    fn order(&self, promise: &Promise, query: &Query, name: &str) -> Result<(), CommandError> {
        let parameters = query.parameters();
        let (run, after, limit) = pagination::read_series(parameters.iter(), MOST_ENTRIES)?;
        let (name, run) = (name.to_owned(), run.to_owned());
        self.errands
            .hand_in(promise, move |lab, keeper| match lab.order(&name, &run) {
                Ok(series) => keeper.leave().keep(move || {
                    Ok(Payload::cbor(&convert::order_page(
                        name, &series, after, limit,
                    )))
                }),
                Err(error) => keeper.leave().refuse(&error.into(), None),
            });
        Ok(())
    }
}

/// Publishes how far experiments are while that changes, until the laboratory is closed.
///
/// # Errors
///
/// When no thread can be started.
pub fn publish(lab: Lab, session: Session, prefix: String, node: String) -> std::io::Result<()> {
    let work = move || {
        let (mut seen, mut told) = (0, BTreeMap::new());
        while let Some(newest) = lab.news(seen) {
            seen = newest;
            let now: BTreeMap<String, Report> = lab
                .reports()
                .into_iter()
                .map(|report| (report.name.clone(), report))
                .collect();
            for (name, report) in &now {
                if told.get(name) == Some(report) {
                    continue;
                }
                let key = keys::experiment(&prefix, &node, name, "progress");
                let Payload { bytes, .. } = Payload::json(&convert::progress(report.clone()));
                let put = session.put(key, bytes).encoding(JSON);
                let put = put.congestion_control(CongestionControl::Drop);
                if let Err(error) = put.wait() {
                    warn!(experiment = name, %error, "failed to publish");
                }
            }
            told = now;
            thread::sleep(BETWEEN);
        }
    };
    let thread = thread::Builder::new().name("progress".into());
    thread.spawn(work).map(drop)
}
