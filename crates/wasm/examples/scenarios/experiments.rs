//! Runs of experiments: random protocols with conditions, ramps and draws; set-points and drives; stops; and
//! a start from a snapshot.

use serde_json::{Value, json};

use crate::random_protocol::random_protocol;
use crate::scenario::Scenario;

/// The number of random protocols.
const PROTOCOLS: u64 = 100;

/// A study of the documentation's kinds: a grid, series, contacts, a condition that stops.
const STUDY: &str = r#"
name = "study"
seed = 5
duration = 8
replicates = 2
spec = { noise = 0.05 }

[[grid]]
n = [12, 40]
informed = [3]

[measure]
order_every = 10
series_every = 25
touch = true
columns = ["milling", "msd(1)", "radius_of_gyration", "contacts_per_body"]

[stop]
when = "order > 0.97 for 2"
"#;

/// Set-points, with drives, and their end.
const STEERED: &str = r#"
name = "steered"
seed = 9
duration = 4
spec = { n = 15 }
setpoints = """
step,id,direction,weight,turn,speed
0,0,1.5,0.5,model,model
0,1,-1.5,2,0.7,0.5
40,1,0.25,1,model,0
60,3,3,,-0.4,1
"""
"#;

/// Returns all of them.
pub fn all() -> impl Iterator<Item = Scenario> {
    let protocols = (0..PROTOCOLS).map(|seed| experiment(&random_protocol(seed).0, 1, 17));
    protocols.chain([
        experiment(STUDY, 4, 100),
        experiment(STEERED, 1, 30),
        from_snapshot(),
    ])
}

/// Executes the runs of a plan in slices.
fn experiment(toml: &str, runs: u64, slice: u64) -> Scenario {
    executed(&json!({"plan": {"toml": toml}}), runs, slice)
}

fn executed(plan: &Value, runs: u64, slice: u64) -> Scenario {
    let mut scenario = Scenario::default();
    let reply = scenario.send(plan);
    assert!(reply.get("ok").is_some(), "{reply}");
    for run in 0..runs {
        scenario.send(&json!({"spec": {"run": run}}));
        let mut reply = scenario.send(&json!({"run": {"run": run}}));
        assert!(reply.get("ok").is_some(), "{reply}");
        while reply["ok"]["finished"] != true {
            reply = scenario.send(&json!({"advance": {"steps": slice}}));
            assert!(reply.get("ok").is_some(), "{reply}");
        }
        scenario.send(&json!({"measures": {"measures": ["order", "neighbour_distance.median"]}}));
    }
    scenario
}

/// Returns an experiment that starts from the snapshot of a swarm.
fn from_snapshot() -> Scenario {
    let mut swarm = Scenario::new(&json!({"create": {"spec": {"n": 30, "seed": 3, "noise": 0.1}}}));
    swarm.step(200, 100);
    let snapshot = swarm.send(&json!({"snapshot": {}}));
    let toml = "name = \"after\"\nseed = 1\nduration = 5\nstart = \"swarm.snapshot\"\n";
    let plan = json!({"plan": {"toml": toml, "start": snapshot["ok"]["snapshot"]}});
    executed(&plan, 1, 60)
}
