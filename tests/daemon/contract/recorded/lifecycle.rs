//! A school from its creation to its deletion, on a daemon without other swarms.

use jostle_proto::keys;
use serde_json::json;

use super::documents::Recorded;
use super::recording_client::{RecordingClient, args};
use crate::support::PREFIX;

/// So slow that a run takes its first step at once and no other.
pub const STANDING: f64 = 1e-4;

pub async fn record_fixtures(recorded: &Recorded) {
    let recorder = RecordingClient::start_with(recorded, "", &["--http", "127.0.0.1:0"]).await;
    let events = recorder.subscribe(keys::event(PREFIX, "school")).await;
    let orders = recorder.subscribe(keys::order(PREFIX, "school")).await;
    let spec = json!({"n": 4, "seed": 1, "start": {"kind": "disc", "radius": 4.0}});
    let create = json!({"name": "school", "spec": spec});
    let create = json!({"request_id": "7c20", "client": "ada@lab", "args": create});
    recorder.node_cmd("create.reply", "create", create).await;
    let existing = json!({"name": "school", "spec": spec, "exist_ok": true});
    recorder
        .node_cmd("create.reply.existing", "create", existing)
        .await;
    recorder.get("spec.reply", "school", "spec").await;
    recorder.event("event.created", &events, "created").await;
    change(&recorder).await;

    // Scheduled: for step 71, and for one that is not reached.
    let named = json!({"request_id": "7c21", "client": "ada@lab", "at_step": 71,
        "args": {"pi3": 1.0}});
    recorder
        .cmd("scheduled.reply", "school", "set", named)
        .await;
    let late = json!({"at_step": 551, "args": {"rate": 2.0}});
    recorder.cmd("", "school", "run", late).await;
    let is_late = |event: &serde_json::Value| event["event"]["applies_at_step"] == 551;
    recorder.sample("event.scheduled", &events, is_late).await;
    recorder
        .get("status.reply.scheduled", "school", "status")
        .await;
    recorder
        .cmd("", "school", "step", json!({"steps": 61}))
        .await;
    recorder.event("event.lapsed", &events, "lapsed").await;
    let is_named = |event: &serde_json::Value| event["event"]["request_id"] == "7c21";
    recorder
        .sample("event.command", &events, |event| {
            is_named(event) && event["event"]["kind"] == "command"
        })
        .await;

    let run = json!({"until_step": 151, "rate": STANDING});
    recorder.cmd("run.reply", "school", "run", run).await;
    recorder.get("", "school", "wait?step=113").await;
    recorder
        .get("status.reply.running", "school", "status")
        .await;
    let fast = json!({"until_step": 151, "rate": null});
    recorder
        .cmd("run.reply.rate_null", "school", "run", fast)
        .await;
    recorder.get("", "school", "wait?phase=paused").await;
    recorder
        .sample("order", &orders, |order| {
            order["step"] == 151 && order["phase"] == "paused"
        })
        .await;
    let run = json!({"rate": STANDING});
    recorder.cmd("", "school", "run", run).await;
    recorder.get("", "school", "wait?step=152").await;
    recorder
        .cmd("pause.reply", "school", "pause", args("pause.args"))
        .await;
    recorder
        .sample("event.phase", &events, |event| {
            event["event"]["reason"] == "requested"
        })
        .await;
    recorder
        .cmd("reset.reply", "school", "reset", args("reset.args"))
        .await;
    recorder.event("event.refused", &events, "refused").await;
    recorder
        .get("events.reply", "school", "events?after=2;limit=5")
        .await;
    recorder
        .get("journal.reply", "school", "journal?limit=3")
        .await;
    recorder
        .get("parameters.reply", "school", "parameters")
        .await;
    recorder
        .get(
            "measures.reply",
            "school",
            "measures?names=order,drift,milling,clusters.largest,neighbour_gap.median",
        )
        .await;
    recorder
        .get(
            "measures.reply.histogram",
            "school",
            "measures?histogram=pair_correlation;bins=4;max=8",
        )
        .await;

    recorder
        .node_get("node.swarms.reply.forked", "swarms")
        .await;
    for name in ["school-2", "school-3"] {
        let reply = if name == "school-2" {
            "discard.reply"
        } else {
            ""
        };
        recorder
            .node_cmd(reply, "discard", json!({"name": name}))
            .await;
    }
    let mut pair = args("create.args.given");
    pair["spec"]["attraction"] = json!({"kind": "all", "accuracy": 1e-6});
    recorder.node_cmd("", "create", pair).await;
    recorder.get("spec.reply.given", "pair", "spec").await;
    for noun in ["hello", "schema", "status", "swarms"] {
        recorder.node_get(&format!("node.{noun}.reply"), noun).await;
    }
    recorder
        .node_get("node.whoami.reply.anybody", "whoami")
        .await;
    let delete = json!({"request_id": "7c22", "client": "ada@lab", "args": args("delete.args")});
    recorder
        .cmd("delete.reply", "school", "delete", delete)
        .await;
    recorder.event("event.deleted", &events, "deleted").await;
    recorder.stop().await;
}

/// Every verb that changes the swarm, each with its arguments of the fixtures.
async fn change(recorder: &RecordingClient<'_>) {
    let school = async |reply: &str, verb: &str, arguments: &str| {
        recorder.cmd(reply, "school", verb, args(arguments)).await;
    };
    school("inform.reply.ids", "inform", "inform.args.ids").await;
    school("step.reply", "step", "step.args").await;
    let fork = args("fork.args");
    let copy = fork["name"].as_str().unwrap().to_owned();
    recorder.cmd("fork.reply", "school", "fork", fork).await;
    recorder.get("status.reply.forked", &copy, "status").await;
    let fork = args("fork.args.step");
    recorder
        .cmd("fork.reply.step", "school", "fork", fork)
        .await;
    school("step.reply.state", "step", "step.args.state").await;
    let state = keys::state(PREFIX, "school");
    recorder.query("state", &state, None).await;
    recorder
        .query("state", &format!("{state}?format=json"), None)
        .await;
    school("inform.reply", "inform", "inform.args").await;
    for select in ["fraction", "within", "informed", "foremost"] {
        let reply = format!("inform.reply.{select}");
        school(&reply, "inform", &format!("inform.args.{select}")).await;
    }
    school("uninform.reply", "uninform", "uninform.args").await;
    let mut set = args("set.args.rules");
    for more in ["set.args", "set.args.measures"] {
        for (name, value) in args(more).as_object().unwrap() {
            set[name] = value.clone();
        }
    }
    recorder.cmd("set.reply", "school", "set", set).await;
    school("set.reply.make_room", "set", "set.args.make_room").await;
    school("inject.reply", "inject", "inject.args").await;
    school("inject.reply.within", "inject", "inject.args.within").await;
    school("inject.reply.at", "inject", "inject.args.at").await;
    school("remove.reply", "remove", "remove.args").await;
    school("batch.reply", "batch", "batch.args").await;
    school("inform.reply.for_time", "inform", "inform.args.for_time").await;
}
