//! `export`: one HTML file that re-runs a swarm or a run in a browser, or plays a recording.

mod recording;

use std::io;
use std::path::Path;

use jostle_experiment::html::{
    Claim, ClaimedRun, Content, EncodedFrames, FrameEncoder, HtmlFile, Module,
};
use jostle_experiment::{EXPERIMENT, Files, Folder, MODEL_VERSION, Plan, PlannedRun, start};
use jostle_physics::model::State;
use jostle_proto::{ErrorCode, ExperimentFile, Reply};
use serde_json::json;

use crate::arguments::ExportArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::progress;
use crate::values;
use crate::verbs::{experiment, snapshot};

/// The page of the player, with places for what it plays.
const PLAYER: &str = include_str!("../../../../web/dist-player/player.html");

/// The number of frames of a run in a file without the module, at most.
const MAX_FRAMES: u64 = 500;

/// Where what is exported comes from.
enum Source<'a> {
    /// A swarm of the daemon.
    Swarm(&'a str),
    /// The file of an experiment.
    Experiment(&'a Path),
    /// A folder of results.
    Results(&'a Path),
    /// A recording.
    Recording(&'a Path),
}

/// Exports what needs no daemon; returns whether that is all.
pub fn without_daemon(output: Output, arguments: &ExportArguments) -> Result<bool, Failure> {
    let source = source(arguments)?;
    let out = &arguments.out;
    if out.is_dir() || out.as_os_str() == "-" {
        return Err(Failure::argument(out.display(), "name a file, FILE.html"));
    }
    if !arguments.force && out.exists() {
        return Err(snapshot::exists(out));
    }
    let content = match source {
        Source::Swarm(_) => return Ok(false),
        Source::Recording(path) => {
            let (name, frames) = recording::frames(path)?;
            let content = Content::Recording { frames };
            write(output, arguments, name, content, None)?;
            return Ok(true);
        }
        Source::Experiment(path) => {
            let files = experiment::read(output, path);
            let files = files.map_err(|problem| Failure::argument("FILE", problem))?;
            let plan = Plan::of(files).map_err(|error| Failure::argument(path.display(), error))?;
            let run = experiment::find_run(&plan, arguments.run.as_deref())?;
            Exported::execute(output, arguments, &plan, run)?
        }
        Source::Results(path) => {
            if arguments.run.is_none() && values::name(&arguments.what).is_ok() {
                output.note(&format!(
                    "{0} is a folder of results here: its first run is exported, and no swarm {0}",
                    arguments.what
                ));
            }
            let wrong = |error: &dyn std::error::Error| Failure::argument(path.display(), error);
            let files = Files::stored(path).map_err(|error| wrong(&error))?;
            let plan = Plan::of(files).map_err(|error| wrong(&error))?;
            let run = experiment::find_run(&plan, arguments.run.as_deref())?;
            let claim = finished(path, &plan, run)?;
            let remedy = "export its experiment.toml, which executes the run again";
            Exported::with(output, arguments, &plan, run, claim, remedy)?
        }
    };
    content.write(output, arguments)?;
    Ok(true)
}

/// Exports a swarm.
pub async fn of_daemon(context: &Context, arguments: &ExportArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let Source::Swarm(swarm) = source(arguments)? else {
        return Err(Failure::defect("what needs no daemon was not exported"));
    };
    let answer = client.get(swarm, "experiment").await;
    let answer = answer.map_err(|error| with_remedy(error.into()))?;
    let reply: Reply<ExperimentFile> = answer.read()?;
    let ExperimentFile {
        file,
        steps,
        state_hash,
        ..
    } = reply.result;
    let plan = Plan::of(Files::from(file.as_str())).map_err(Failure::unreadable)?;
    let run = &plan.runs()[0];
    let exported = if plan.point(run).steps == steps {
        let claim = Claim {
            steps,
            state_hash,
            fault: None,
        };
        let remedy = format!("`jostle verify {swarm}` names the step");
        Exported::with(*output, arguments, &plan, run, claim, &remedy)?
    } else {
        output.note(&format!(
            "commands were applied at step {steps}: the run takes one step more, whose state hash is \
             computed here"
        ));
        Exported::execute(*output, arguments, &plan, run)?
    };
    exported.write(*output, arguments)
}

/// What `arguments` names.
fn source(arguments: &ExportArguments) -> Result<Source<'_>, Failure> {
    let what = arguments.what.as_str();
    let path = Path::new(what);
    let source = match path.extension().and_then(|extension| extension.to_str()) {
        Some("mcap") => Source::Recording(path),
        Some("toml") => Source::Experiment(path),
        _ if path.join(EXPERIMENT).exists() => Source::Results(path),
        _ if values::name(what).is_ok() => Source::Swarm(what),
        _ if path.is_dir() => Source::Results(path),
        _ => {
            let problem = "name a swarm, an experiment file FILE.toml, a folder of its results, or a \
                           recording FILE.mcap";
            return Err(Failure::argument(what, problem));
        }
    };
    let has_runs = matches!(source, Source::Experiment(_) | Source::Results(_));
    match arguments.run.is_some() && !has_runs {
        true => Err(Failure::argument(
            "--run",
            "only an experiment has runs: leave it out",
        )),
        false => Ok(source),
    }
}

/// The rejection of a swarm whose commands since its start are no experiment, with the remedy.
fn with_remedy(failure: Failure) -> Failure {
    let advice = failure.rejection().and_then(|error| match error.code {
        ErrorCode::Conflict if error.message.contains("snapshot") => Some(
            "`jostle export FILE.toml` exports that file, and `jostle export FILE.mcap` a recording",
        ),
        ErrorCode::IncorrectState => Some("`jostle export FILE.mcap` exports the recording itself"),
        _ => None,
    });
    failure.with_advice(advice.map(str::to_owned))
}

/// How a run in a folder of results ended.
fn finished(path: &Path, plan: &Plan, run: &PlannedRun) -> Result<Claim, Failure> {
    let wrong = |problem: String| Failure::argument(path.display(), problem);
    let finished = Folder::read(path, plan).map_err(|error| wrong(error.to_string()))?;
    if finished.model_version != MODEL_VERSION {
        return Err(wrong(format!(
            "version {} of the model executed its runs, and this one has version {MODEL_VERSION}: \
             export its experiment.toml, which executes the run again",
            finished.model_version
        )));
    }
    let row = finished.rows.into_iter().find(|row| row.run == run.name);
    let row = row.ok_or_else(|| {
        wrong(format!(
            "run {:?} is not finished: `jostled run` continues the experiment",
            run.name
        ))
    })?;
    Ok(Claim {
        steps: row.steps,
        state_hash: row.state_hash,
        fault: row.fault,
    })
}

/// A run that is written.
struct Exported {
    name: String,
    run: ClaimedRun,
}

impl Exported {
    /// Executes a run, and takes how it ends as what the file states.
    fn execute(
        output: Output,
        arguments: &ExportArguments,
        plan: &Plan,
        run: &PlannedRun,
    ) -> Result<Self, Failure> {
        let (claim, frames) = execute(output, arguments.no_engine, plan, run)?;
        let run = ClaimedRun {
            frames,
            ..ClaimedRun::new(plan, run, claim)
        };
        let name = plan.name.clone();
        Ok(Self { name, run })
    }

    /// Takes this as what the file states; executes the run only for its frames. `remedy` is for a run
    /// that then ends otherwise.
    fn with(
        output: Output,
        arguments: &ExportArguments,
        plan: &Plan,
        run: &PlannedRun,
        claim: Claim,
        remedy: &str,
    ) -> Result<Self, Failure> {
        if !arguments.no_engine {
            let (name, run) = (plan.name.clone(), ClaimedRun::new(plan, run, claim));
            return Ok(Self { name, run });
        }
        let exported = Self::execute(output, arguments, plan, run)?;
        let found = &exported.run.claim;
        match *found == claim {
            true => Ok(exported),
            false => Err(Failure::new(
                "different",
                format!("the run ends {found} here, and not {claim}: {remedy}"),
            )),
        }
    }

    fn write(self, output: Output, arguments: &ExportArguments) -> Result<(), Failure> {
        let Self { name, run } = self;
        let module = match arguments.no_engine {
            true => None,
            false => Some(module(arguments)?),
        };
        let content = Content::Run(Box::new(run));
        write(output, arguments, name, content, module.as_ref())
    }
}

/// Executes a run; returns how it ends, and its frames if they are wanted.
fn execute(
    output: Output,
    has_frames: bool,
    plan: &Plan,
    run: &PlannedRun,
) -> Result<(Claim, Option<EncodedFrames>), Failure> {
    let point = plan.point(run);
    let steps = point.steps;
    let every = steps.div_ceil(MAX_FRAMES).max(1);
    let mut encoder = FrameEncoder::new(point.spec.parameters.dt);
    // The state after the last frame, with which the run may end.
    let mut rest = None;
    let mut add = |state: &State| {
        if has_frames {
            let is_due = state.step.is_multiple_of(every);
            rest = (!is_due).then(|| state.clone());
            if is_due {
                encoder.add_state(state);
            }
        }
    };
    let fault = |reason: String| Failure::argument(&run.name, reason);
    add(&start(plan, run).map_err(|error| fault(error.to_string()))?);
    let bar = progress::bar(output, Some(steps), progress::STEPS, &plan.name);
    let ended = Claim::of(plan, run, |state| {
        progress::show_step(&bar, state.step);
        add(state);
        true
    });
    bar.finish_and_clear();
    let ended = ended.ok_or_else(|| Failure::defect("a run was cancelled"))?;
    let claim = ended.map_err(fault)?;
    if let Some(state) = rest {
        encoder.add_state(&state);
    }
    Ok((claim, has_frames.then(|| encoder.finish())))
}

/// The module of the file.
fn module(arguments: &ExportArguments) -> Result<Module, Failure> {
    let path = arguments.wasm.clone().or_else(Module::installed);
    let Some(path) = path else {
        let problem = "no wasm module is installed: name one, or --no-engine makes a file that plays \
                       frames of the run";
        return Err(Failure::argument("--wasm", problem));
    };
    Module::read(&path).map_err(|error| Failure::argument("--wasm", error))
}

/// Writes a file and says what is in it.
fn write(
    output: Output,
    arguments: &ExportArguments,
    name: String,
    content: Content,
    module: Option<&Module>,
) -> Result<(), Failure> {
    let licences = module.map_or("", |it| it.licences.as_str());
    let file = HtmlFile::new(name, licences, content);
    let html = file.fill(PLAYER, module);
    let html = html.map_err(Failure::defect)?;
    let out = &arguments.out;
    let written = snapshot::write(out, html.as_bytes(), arguments.force);
    written.map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => snapshot::exists(out),
        _ => Failure::file(out.display(), error),
    })?;
    let bytes = format::bytes(html.len() as u64);
    let (claim, what) = match &file.content {
        Content::Run(run) => (
            Some(&run.claim),
            format!(
                "run {}, {:?}, of {}, which ends {}",
                run.run.index + 1,
                run.run.name,
                file.name,
                run.claim
            ),
        ),
        Content::Recording { frames } => {
            let count = format::count(frames.count, "frame");
            (None, format!("{count} of {}", file.name))
        }
    };
    let document = json!({
        "file": out.display().to_string(),
        "bytes": html.len(),
        "name": file.name,
        "has_engine": module.is_some(),
        "claim": claim,
    });
    output.print(
        &document,
        &format!("wrote {bytes} to {}: {what}", out.display()),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_has_no_results_hides_no_swarm() {
        let of = |what: &str| ExportArguments {
            what: what.to_owned(),
            out: "out.html".into(),
            run: None,
            no_engine: false,
            wasm: None,
            force: false,
        };
        // The folder of this crate has a folder of this name.
        assert!(Path::new("src").is_dir());
        assert!(matches!(source(&of("src")), Ok(Source::Swarm("src"))));
        assert!(matches!(source(&of("./src")), Ok(Source::Results(_))));
    }

    #[test]
    fn the_page_of_the_player_has_the_places() {
        let frames = FrameEncoder::new(0.02).finish();
        let content = Content::Recording { frames };
        let file = HtmlFile::new("a".to_owned(), "", content);
        let html = file.fill(PLAYER, None).expect("a player");
        assert_eq!(HtmlFile::parse(&html).expect("whole"), file);
        for length in [1000, html.len() - 1000] {
            let error = HtmlFile::parse(&html[..length]).expect_err("cut off");
            assert!(error.to_string().contains("ends early"), "{error}");
        }
    }
}
