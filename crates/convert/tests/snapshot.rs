//! Snapshots of simulations, compared with the fixtures of the protocol.
#![expect(clippy::unwrap_used, reason = "tests")]

use jostle_convert::{SnapshotError, snapshot};
use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::{Change, Simulation, Spec};
use jostle_proto::snapshot::SnapshotPhase;
use jostle_proto::{Reply, Snapshot};

fn recorded() -> Snapshot {
    let text = include_str!("../../../proto/fixtures/snapshot.reply.json");
    let reply: Reply<Snapshot> = serde_json::from_str(text).unwrap();
    reply.result
}

#[test]
fn a_snapshot_is_read_and_written_as_it_was() {
    let snapshot = recorded();
    let checkpoint = snapshot::from_proto(&snapshot).unwrap();
    snapshot::check(&checkpoint).unwrap();
    let doing = SnapshotPhase::Running { until: Some(9) };
    let written = snapshot::to_proto(&snapshot.swarm, &checkpoint, doing.clone());
    let expected = Snapshot {
        doing,
        rate: snapshot.spec.rate,
        scheduled: Vec::new(),
        when: Vec::new(),
        past: Vec::new(),
        protocol_draws: 0,
        seq: snapshot.seq - snapshot.annotations,
        annotations: 0,
        pending: None,
        controllers: Vec::new(),
        events: 0,
        lines: 0,
        is_last: false,
        digest: None,
        ..snapshot
    };
    assert_eq!(written, expected);
}

#[test]
fn a_simulation_goes_on_from_its_snapshot_with_the_same_hashes() {
    let mut spec = Spec::new(40, 3);
    spec.parameters.noise = 0.1;
    let mut simulation = Simulation::new(&spec).unwrap();
    simulation
        .apply(&Change::inform(Selection::Count(4), 0.5))
        .unwrap();
    let step = |simulation: &mut Simulation| {
        simulation.step().unwrap();
    };
    (0..50).for_each(|_| step(&mut simulation));
    let paused = SnapshotPhase::Paused {
        reason: "command".into(),
    };
    let message = snapshot::to_proto("school", &simulation.checkpoint(), paused);
    let bytes = jostle_proto::to_cbor(&message);
    let read = snapshot::from_proto(&Snapshot::from_cbor(&bytes).unwrap()).unwrap();
    let mut other = Simulation::from_checkpoint(&read, Box::new(|_| Ok(())));
    for _ in 0..50 {
        step(&mut simulation);
        step(&mut other);
        assert_eq!(simulation.state_hash(), other.state_hash());
    }
    assert_eq!(simulation.means, other.means);
}

#[test]
fn a_changed_snapshot_is_rejected() {
    type Change = fn(&mut Snapshot);
    let cases: [(&str, Change); 8] = [
        ("of snapshots", |it| it.version += 1),
        ("of the model", |it| it.model_version += 1),
        ("hash", |it| it.x[0] += 0.5),
        ("hash", |it| it.state_hash.replace_range(..1, "!")),
        ("columns differ", |it| it.alpha.push(0.0)),
        ("warm start differ", |it| it.memory.multiplier.push(0.0)),
        ("unknown individual", |it| {
            it.lapses.push(jostle_proto::snapshot::Lapse {
                id: 4_000,
                at_step: 9,
            });
        }),
        ("publish_every", |it| it.spec.publish_every = 0),
    ];
    for (part, change) in cases {
        let mut snapshot = recorded();
        change(&mut snapshot);
        let error = snapshot::from_proto(&snapshot).unwrap_err().to_string();
        assert!(error.contains(part), "{part}: {error}");
    }
}

#[test]
fn a_state_that_no_simulation_can_have_is_rejected() {
    type Change = fn(&mut jostle_physics::simulation::Checkpoint);
    let cases: [(&str, Change); 15] = [
        ("individuals", |it| it.state.configuration.id.clear()),
        ("ids", |it| it.state.configuration.id.swap(0, 1)),
        ("ids", |it| it.state.configuration.next_id = 0),
        ("origin", |it| it.state.configuration.origin[1] = i64::MIN),
        ("finite", |it| it.state.configuration.x[0] = f64::NAN),
        ("finite", |it| {
            it.state.configuration.direction[0] = f64::INFINITY;
        }),
        ("finite", |it| it.means.drift = f64::INFINITY),
        ("finite", |it| it.exactness.residual = f64::NAN),
        ("weight", |it| it.state.configuration.weight[0] = -1.0),
        ("pi1", |it| it.state.parameters.pi1 = 99.0),
        ("publish_every", |it| it.publish_every = 0),
        ("count", |it| it.state.step = u64::MAX),
        ("solver", |it| it.state.warm_start.order[0] = 99),
        ("solver", |it| it.state.warm_start.contacts[0].code = 8),
        ("solver", |it| {
            it.state.warm_start.contacts[0].multiplier = -1.0;
        }),
    ];
    for (part, change) in cases {
        let mut checkpoint = snapshot::from_proto(&recorded()).unwrap();
        change(&mut checkpoint);
        let error = snapshot::check(&checkpoint).unwrap_err();
        assert!(
            matches!(error, SnapshotError::Impossible(_)),
            "{part}: {error}"
        );
        assert!(error.to_string().contains(part), "{part}: {error}");
    }
}
