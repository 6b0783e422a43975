use super::*;
use crate::testing::state;

fn at_step(step: u64) -> State {
    State {
        step,
        ..state(&[[step as f64, 0.0, 0.0]])
    }
}

fn steps(past: &Past) -> Vec<u64> {
    past.frames().map(|frame| frame.step).collect()
}

#[test]
fn it_reaches_back_as_far_as_the_lag() {
    let mut past = Past::new(3);
    (0..7).for_each(|step| past.observe(&at_step(step)));
    assert_eq!(steps(&past), [3, 4, 5, 6]);
    assert_eq!(past.at(4).unwrap().x, [4.0]);
    assert_eq!((past.at(2), past.at(7)), (None, None));
    // Steps may be left out.
    past.observe(&at_step(9));
    assert_eq!(steps(&past), [6, 9]);
    assert_eq!(past.at(8), None);
    let mut none = Past::new(0);
    none.observe(&at_step(1));
    assert_eq!(steps(&none), [0; 0]);
}

#[test]
fn the_same_step_replaces_and_a_lower_one_clears() {
    let mut past = Past::new(2);
    past.observe(&at_step(4));
    past.observe(&at_step(5));
    let mut changed = at_step(5);
    changed.configuration.push(8.0, 9.0, 1.0);
    past.observe(&changed);
    assert_eq!(steps(&past), [4, 5]);
    assert_eq!(past.at(5).unwrap().y, [0.0, 9.0]);
    past.observe(&at_step(0));
    assert_eq!(steps(&past), [0]);
}

#[test]
fn frames_restore_it_and_damaged_ones_are_rejected() {
    let mut past = Past::new(2);
    (0..5).for_each(|step| past.observe(&at_step(step)));
    let frames: Vec<Frame> = past.frames().cloned().collect();
    assert_eq!(Past::from_frames(2, frames.clone()).unwrap(), past);
    assert_eq!(
        steps(&Past::from_frames(1, frames.clone()).unwrap()),
        [3, 4]
    );
    assert_eq!(Past::from_frames(0, frames.clone()).unwrap(), Past::new(0));
    let damages: [fn(&mut [Frame]); 5] = [
        |frames| {
            let Frame {
                id, x, y, alpha, ..
            } = &mut frames[1];
            id.clear();
            [x, y, alpha].into_iter().for_each(Vec::clear);
        },
        |frames| frames[1].y[0] = f64::NAN,
        |frames| frames[1].step = 2,
        |frames| frames[1].alpha.clear(),
        |frames| {
            frames[1].id.push(0);
            let Frame { x, y, alpha, .. } = &mut frames[1];
            [x, y, alpha].into_iter().for_each(|it| it.push(0.0));
        },
    ];
    for damage in damages {
        let mut frames = frames.clone();
        damage(&mut frames);
        let error = Past::from_frames(2, frames).unwrap_err();
        assert!(matches!(error, PastError::Frame { .. }), "{error}");
    }
}

#[test]
fn individuals_are_matched_by_id_and_positions_are_absolute() {
    let mut earlier = state(&[[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]]);
    let mut past = Past::new(1);
    past.observe(&earlier);
    let now = &mut earlier.configuration;
    now.remove(&[1]);
    now.push(7.0, 0.0, 0.0);
    now.origin = [-1, 2];
    now.x = vec![1025.25, 1027.5, 0.0];
    let frame = past.at(0).unwrap();
    let matched: Vec<_> = frame.matched(now).collect();
    assert_eq!(matched, [(0, 0), (1, 2)]);
    assert_eq!(frame.displacement(0, now, 0), [0.25, 2048.0]);
    assert_eq!(frame.displacement(2, now, 1), [0.5, 2048.0]);
    // An id may also be missing in the frame alone.
    let id = vec![0, 3];
    let frame = Frame {
        id,
        ..Frame::default()
    };
    assert_eq!(frame.matched(now).collect::<Vec<_>>(), [(0, 0), (2, 1)]);
}

#[test]
fn the_limit_is_of_steps_times_individuals_and_8() {
    assert_eq!(check_past(2500, 92), Ok(()));
    let poses = 250_100;
    assert_eq!(check_past(2501, 92), Err(PastError::TooLarge { poses }));
    assert!(
        check_past(u64::MAX, 2)
            .unwrap_err()
            .to_string()
            .contains("shorter lag")
    );
}

#[test]
fn its_lag_may_change_and_its_poses_are_limited() {
    let mut past = Past::default();
    past.observe_with(&at_step(0), 0);
    assert_eq!(steps(&past), [0; 0]);
    (1..6).for_each(|step| past.observe_with(&at_step(step), 10));
    assert_eq!(steps(&past), [1, 2, 3, 4, 5]);
    past.observe_with(&at_step(6), 2);
    assert_eq!(steps(&past), [4, 5, 6]);
    past.observe_with(&at_step(7), 3);
    assert_eq!(steps(&past), [4, 5, 6, 7]);
    assert_eq!(past.earlier_poses(), 3 * 9);
    past.observe_with(&at_step(8), 0);
    assert_eq!((steps(&past), past.earlier_poses()), (vec![], 0));

    let poses = vec![[0.0; 3]; 100_000];
    for step in 10..15 {
        let large = State {
            step,
            ..state(&poses)
        };
        past.observe_with(&large, 4);
    }
    assert_eq!(steps(&past), [12, 13, 14]);
    assert_eq!(past.earlier_poses(), 200_016);
}
