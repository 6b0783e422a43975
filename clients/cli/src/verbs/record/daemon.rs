//! Recordings on the daemon: start, list, stop, delete.

use jostle_proto::{
    BeginRecordingArgs, NodeReply, RecordArgs, Recording, RecordingFormat, RecordingGap,
    RecordingName, RecordingPhase, Recordings,
};

use crate::arguments::RecordArguments;
use crate::context::Context;
use crate::failure::Failure;
use crate::format;
use crate::table::Column;

pub async fn record(context: &Context, arguments: &RecordArguments) -> Result<(), Failure> {
    let Context { client, output } = context;
    let named = |recording: &String| RecordingName {
        recording: recording.clone(),
    };
    let (args, text): (_, fn(&Recording) -> String) = match arguments {
        RecordArguments {
            stop: Some(name), ..
        } => (RecordArgs::Stop(named(name)), describe),
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
            (RecordArgs::Begin(args), started)
        }
        _ => return list(context).await,
    };
    let answer = client
        .command_node("record", &args, &arguments.sender)
        .await;
    let answer = match (
        answer.map_err(Failure::from),
        arguments.stop.as_ref().or(arguments.delete.as_ref()),
    ) {
        (Err(failure), Some(name)) if failure.is_unknown_name() => {
            let there = client.recordings().await.unwrap_or_default();
            let list = "jostle record --list";
            return Err(failure.describe_unknown("recording", name, &there, list));
        }
        (Err(failure), None) if failure.is_unknown_name() => {
            let swarm = arguments.name.as_deref().unwrap_or_default();
            return Err(client.no_swarm(swarm).await.into());
        }
        (answer, _) => answer?,
    };
    output.reply(&answer, |it: &NodeReply<Recording>| text(&it.result))
}

async fn list(context: &Context) -> Result<(), Failure> {
    let Context { client, output } = context;
    let answer = client.get_node("recordings").await?;
    let reply: NodeReply<Recordings> = answer.read()?;
    let if_empty = format!(
        "no recordings on {}: `jostle record SWARM --at-daemon` starts one",
        reply.node
    );
    let columns: [Column<Recording>; 11] = [
        ("recording", |it| it.recording.clone()),
        ("swarm", |it| it.swarm.clone()),
        ("phase", |it| phase(it.phase).into()),
        ("format", |it| match it.format {
            RecordingFormat::Mcap => "mcap".into(),
            RecordingFormat::Parquet => "parquet".into(),
        }),
        ("every", |it| format::or_none(it.every)),
        ("frames", |it| it.frames.to_string()),
        ("missed", |it| it.missed.to_string()),
        ("gap", |it| format::or_none(it.gap.map(gap))),
        ("parts", |it| it.parts.to_string()),
        ("size", |it| format::bytes(it.bytes)),
        ("reason", |it| format::or_none(it.reason.as_ref())),
    ];
    output.list(&answer, &reply.result.recordings, columns, &if_empty)
}

fn started(recording: &Recording) -> String {
    let Recording {
        recording, swarm, ..
    } = recording;
    format!(
        "the daemon records {swarm} as {recording}: `jostle record --list` shows its status, \
         `jostle record --stop {recording}` ends it"
    )
}

fn describe(it: &Recording) -> String {
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
    text.push_str(&super::fetch::missing_note(it));
    text.push_str(&super::fetch::lost_note(it.lost_parts));
    text
}

/// The steps between which the last lost states were.
fn gap(RecordingGap { after, until, .. }: RecordingGap) -> String {
    let after = after.map(|at| at.step.to_string()).unwrap_or_default();
    format!("{after}..{}", until.step)
}

fn phase(phase: RecordingPhase) -> &'static str {
    match phase {
        RecordingPhase::Recording => "recording",
        RecordingPhase::Ended => "ended",
        RecordingPhase::Failed => "failed",
    }
}

#[cfg(test)]
mod tests {
    use jostle_proto::RecordedAt;

    use super::*;

    #[test]
    fn a_gap_is_named_apart_from_states_that_were_left_out() {
        let at = |epoch, step| RecordedAt { epoch, step };
        let mut recording = Recording {
            recording: "take".to_owned(),
            swarm: "school".to_owned(),
            format: RecordingFormat::Mcap,
            every: Some(1),
            phase: RecordingPhase::Ended,
            reason: Some("stopped".to_owned()),
            frames: 40,
            missed: 0,
            lost: 0,
            gap: None,
            lost_parts: 0,
            parts: 2,
            bytes: 2048,
            began_unix_secs: 0,
            drop_when_behind: true,
            max_bytes: None,
            temporary: false,
        };
        let whole = "take is ended (stopped): 40 frames of school in 2 parts, 2.0 KiB";
        assert_eq!(describe(&recording), whole);
        (recording.missed, recording.lost) = (12, 9);
        recording.gap = Some(RecordingGap {
            after: Some(at(1, 30)),
            until: at(2, 40),
            missed: 9,
        });
        let missing = "; 3 were left out because the disk was behind; 9 were lost when the daemon \
                       ended, the last between step 30 of epoch 1 and step 40 of epoch 2";
        assert_eq!(describe(&recording), format!("{whole}{missing}"));
        assert_eq!(recording.gap.map(gap).as_deref(), Some("30..40"));
        recording.missed = 9;
        recording.gap = Some(RecordingGap {
            after: None,
            until: at(2, 40),
            missed: 9,
        });
        let missing = "; 9 were lost when the daemon ended, the last before step 40 of epoch 2";
        assert_eq!(describe(&recording), format!("{whole}{missing}"));
        assert_eq!(recording.gap.map(gap).as_deref(), Some("..40"));
    }
}
