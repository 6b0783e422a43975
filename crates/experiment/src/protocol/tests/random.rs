//! Random protocols, compared with the same commands sent to a simulation.

use jostle_physics::simulation::{Change, Settings};

use super::random_protocol::{STEPS, When, random_protocol};
use super::{ByHand, finished};
use crate::plan::Plan;

#[test]
fn a_hundred_random_protocols_are_the_commands_of_a_swarm() {
    let (mut fired, mut faults) = (0, 0);
    for seed in 0..100u64 {
        let (text, blocks) = random_protocol(seed);
        let ramp = |step: u64| {
            let pi3 = 1.0 + (step as f64 / 10.0 - 1.0) / 4.0;
            Change::Set(Settings {
                pi3: Some(pi3),
                ..Settings::default()
            })
        };
        let plan = Plan::parse(&text).unwrap_or_else(|error| panic!("{error}\n{text}"));
        let finished = finished(&plan, 0);

        let mut by_hand = ByHand::new(&plan, &plan.runs()[0]);
        let (mut above, mut is_done) = (vec![0u64; blocks.len()], vec![false; blocks.len()]);
        let mut rejected = None;
        'run: for step in 0..STEPS {
            let order = by_hand.simulation.order().order;
            let mut due = Vec::new();
            for (index, (when, _)) in blocks.iter().enumerate() {
                if let When::Ordered(limit, lasting) = when {
                    above[index] = if order > *limit { above[index] + 1 } else { 0 };
                    if !is_done[index] && above[index] > *lasting {
                        is_done[index] = true;
                        fired += 1;
                        due.push(index);
                    }
                }
            }
            let at_step = |(_, (when, _)): &(usize, &(When, Vec<Change>))| matches!(when, When::Step(at) if *at == step);
            due.extend(
                blocks
                    .iter()
                    .enumerate()
                    .filter(at_step)
                    .map(|(index, _)| index),
            );
            let mut changes: Vec<Change> =
                due.iter().flat_map(|&at| blocks[at].1.clone()).collect();
            if (10..=50).contains(&step) && step.is_multiple_of(10) {
                changes.push(ramp(step));
            }
            for change in changes {
                let seq = by_hand.next_draw;
                if let Err(error) = by_hand.simulation.apply_at(seq, &change) {
                    rejected = Some(error.to_string());
                    break 'run;
                }
                by_hand.next_draw += 1;
            }
            by_hand.simulation.step().unwrap();
        }
        // A rejected command ends the run where the swarm rejects it.
        match (&finished.fault, &rejected) {
            (None, None) => {}
            (Some(fault), Some(error)) => {
                assert!(fault.contains(error), "{fault}: {error}");
                faults += 1;
            }
            other => panic!("seed {seed}: {other:?}"),
        }
        if let Some(row) = finished.row {
            assert_eq!(row.state_hash, by_hand.hash(), "seed {seed}");
        }
    }
    assert!(
        fired > 100 && faults < 10,
        "{fired} conditions fired, {faults} runs ended early"
    );
}
