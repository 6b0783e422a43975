//! Recordings that the daemon makes: begun, listed, stopped, deleted.

use jostle_proto::{
    BeginRecordingArgs, NodeReply, RecordArgs, Recording, RecordingFormat, RecordingName,
    RecordingPhase, Recordings,
};

use crate::arguments::RecordArguments;
use crate::bus::Bus;
use crate::failure::{Failure, is_unknown_name};
use crate::format;
use crate::output::Output;
use crate::table;
use crate::verbs::print;

/// Does what is asked for.
pub async fn record(bus: &Bus, output: Output, arguments: &RecordArguments) -> Result<(), Failure> {
    let named = |recording: &String| RecordingName {
        recording: recording.clone(),
    };
    let (args, tell): (_, fn(&Recording) -> String) = match arguments {
        RecordArguments {
            stop: Some(name), ..
        } => (RecordArgs::Stop(named(name)), line),
        RecordArguments {
            delete: Some(name), ..
        } => (RecordArgs::Delete(named(name)), |it| {
            format!("deleted {}", it.recording)
        }),
        RecordArguments {
            name: Some(swarm), ..
        } => {
            let args = BeginRecordingArgs {
                swarm: swarm.clone(),
                recording: arguments.as_name.clone(),
                format: None,
                every: arguments.every,
                steps: arguments.steps,
                drop_when_behind: arguments.drop_when_behind,
                max_bytes: arguments.max_size,
                temporary: false,
            };
            (RecordArgs::Begin(args), begun)
        }
        _ => return list(bus, output).await,
    };
    let answer = bus.command_node("record", &args, &arguments.sender).await;
    let answer = match (
        answer,
        arguments.stop.as_ref().or(arguments.delete.as_ref()),
    ) {
        (Err(Failure::Refused { error, .. }), Some(name)) if is_unknown_name(&error) => {
            let there = bus.recordings().await.unwrap_or_default();
            return Err(Failure::unknown("recording", name, there, error));
        }
        (Err(Failure::Refused { error, .. }), None) if is_unknown_name(&error) => {
            let swarm = arguments.name.as_deref().unwrap_or_default();
            return Err(bus.no_swarm(swarm).await);
        }
        (answer, _) => answer?,
    };
    print(output, &answer, |reply: &NodeReply<Recording>| {
        tell(&reply.result)
    })
}

async fn list(bus: &Bus, output: Output) -> Result<(), Failure> {
    let answer = bus.get_node("recordings").await?;
    let reply: NodeReply<Recordings> = answer.read()?;
    if !output.json && reply.result.recordings.is_empty() {
        let node = &reply.node;
        output.note(&format!(
            "no recordings on {node}: `jostle record SWARM --at-daemon` begins one"
        ));
        return Ok(());
    }
    print(output, &answer, |reply: &NodeReply<Recordings>| {
        let recordings = reply.result.recordings.iter();
        let header = [
            "recording",
            "swarm",
            "phase",
            "format",
            "every",
            "frames",
            "missed",
            "parts",
            "size",
            "reason",
        ];
        table::table(header, recordings.map(row).collect())
    })
}

fn begun(recording: &Recording) -> String {
    let Recording {
        recording, swarm, ..
    } = recording;
    format!(
        "the daemon records {swarm} as {recording}: `jostle record --list` shows how it stands, \
         `jostle record --stop {recording}` ends it"
    )
}

/// How a recording stands, in a line.
fn line(it: &Recording) -> String {
    let reason = it.reason.iter().map(|reason| format!(" ({reason})"));
    let mut text = format!(
        "{} is {}{}: {} of {} in {}, {}",
        it.recording,
        phase(it.phase),
        reason.collect::<String>(),
        format::count(it.frames, "frame"),
        it.swarm,
        format::count(it.parts, "part"),
        format::bytes(it.bytes)
    );
    if it.missed > 0 {
        text.push_str(&super::fetch::left_out(it.missed));
    }
    text
}

fn row(it: &Recording) -> [String; 10] {
    [
        it.recording.clone(),
        it.swarm.clone(),
        phase(it.phase).into(),
        match it.format {
            RecordingFormat::Mcap => "mcap".into(),
            RecordingFormat::Parquet => "parquet".into(),
        },
        it.every
            .map_or_else(|| format::NONE.into(), |every| every.to_string()),
        it.frames.to_string(),
        it.missed.to_string(),
        it.parts.to_string(),
        format::bytes(it.bytes),
        it.reason.clone().unwrap_or_else(|| format::NONE.into()),
    ]
}

fn phase(phase: RecordingPhase) -> &'static str {
    match phase {
        RecordingPhase::Recording => "recording",
        RecordingPhase::Ended => "ended",
        RecordingPhase::Failed => "failed",
    }
}
