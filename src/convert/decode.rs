//! Decodes what a swarm published, from a recording.

use jostle_physics::model::body::Gaps;
use jostle_physics::model::configuration::Configuration;
use jostle_physics::model::parameters::Parameters;
use jostle_physics::observables::{Order, RunningMeans};
use jostle_physics::simulation::{Exactness, Spec};
use jostle_proto::{EventKind, LARGEST_WHOLE, Lenient, ParameterValues};
use serde_json::Value;

use crate::playback::source::{FrameIndex, RecordedEvent, RecordedFrame};

/// Decodes a state: its position in the recording, and the frame that it shows under these
/// parameters.
pub fn decode_state(
    bytes: &[u8],
    parameters: Parameters,
) -> Result<(FrameIndex, RecordedFrame), String> {
    let state = jostle_proto::State::from_cbor(bytes)?;
    let n = state.id.len();
    let columns = [
        &state.x,
        &state.y,
        &state.alpha,
        &state.weight,
        &state.direction,
    ];
    if n == 0 || columns.iter().any(|column| column.len() != n) {
        return Err("its columns are empty, or not of one length".to_owned());
    }
    if !state.id.is_sorted_by(|a, b| a < b) {
        return Err("its ids are not ascending".to_owned());
    }
    let (order, certificate) = (state.order, state.certificate);
    let [vx, vy] = order.velocity;
    let [mean_vx, mean_vy] = order.mean_velocity.unwrap_or_default();
    let numbers = [state.time, order.order, vx, vy, mean_vx, mean_vy]
        .into_iter()
        .chain(order.mean_order)
        .chain(order.direction)
        .chain(order.direction_strength)
        .chain(order.drift)
        .chain(order.mean_drift)
        .chain(certificate.worst_gap)
        .chain([certificate.residual]);
    let mut all = numbers.chain(columns.into_iter().flatten().copied());
    if !all.all(f64::is_finite) {
        return Err("it has a number that is not finite".to_owned());
    }
    drop(all);
    if state.weight.iter().any(|weight| *weight < 0.0) {
        return Err("it has a negative weight".to_owned());
    }
    if state.epoch > LARGEST_WHOLE || state.step > LARGEST_WHOLE {
        return Err("its epoch or step is too large".to_owned());
    }
    let count = |count: u64| usize::try_from(count).unwrap_or(usize::MAX);
    let index = FrameIndex {
        epoch: state.epoch,
        step: state.step,
        time: state.time,
        position: 0.0,
    };
    let frame = RecordedFrame {
        parameters,
        configuration: Configuration {
            origin: state.origin,
            next_id: 0,
            lapses_at: vec![None; n],
            drives: Default::default(),
            id: state.id,
            x: state.x,
            y: state.y,
            alpha: state.alpha,
            weight: state.weight,
            direction: state.direction,
        },
        order: Order {
            order: order.order,
            velocity: order.velocity,
            direction: order.direction,
            strength: order.direction_strength,
            drift: order.drift,
        },
        // States contain the means alone: these are the sums of one step with the same means.
        means: RunningMeans {
            count: u64::from(order.mean_order.is_some()),
            order: order.mean_order.unwrap_or_default(),
            velocity: [mean_vx, mean_vy],
            directed: u64::from(order.mean_drift.is_some()),
            drift: order.mean_drift.unwrap_or_default(),
        },
        exactness: Exactness {
            residual: certificate.residual,
            degraded: certificate.degraded,
            contacts: count(certificate.contacts),
            iterations: count(certificate.iterations),
        },
        gaps: Gaps {
            worst_gap: certificate.worst_gap,
            crossed: count(certificate.crossed),
        },
    };
    Ok((index, frame))
}

/// Decodes the spec of a recorded swarm, and its parameters at the start of the recording.
pub fn decode_spec(spec: &str, parameters: &str) -> Result<(Spec, Parameters), String> {
    let Lenient(sent) =
        serde_json::from_str::<Lenient<jostle_proto::Spec>>(spec).map_err(|it| it.to_string())?;
    let n = usize::try_from(sent.n).unwrap_or(usize::MAX);
    let spec = jostle_convert::spec::from_proto(&sent, n).map_err(|it| it.to_string())?;
    let values: ParameterValues = serde_json::from_str(parameters).map_err(|it| it.to_string())?;
    let parameters = jostle_convert::parameters::parameters(&values, spec.parameters.dt);
    let parameters = parameters.map_err(|it| it.to_string())?;
    for parameters in [&spec.parameters, &parameters] {
        parameters.check(0.0).map_err(|it| it.to_string())?;
    }
    Ok((spec, parameters))
}

/// The verb of a command, and its arguments.
pub type VerbAndArgs = (String, Value);

/// Decodes an event: as a playback shows it, and the executed command with its arguments. The
/// playback does not show the deletion of the swarm, since it still exists.
pub fn decode_event(bytes: &[u8]) -> Result<(Option<RecordedEvent>, Option<VerbAndArgs>), String> {
    let event: jostle_proto::Event =
        serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    if event.step > LARGEST_WHOLE {
        return Err("its step is too large".to_owned());
    }
    let shown = match event.event {
        EventKind::Deleted { .. } => None,
        ref kind => Some(RecordedEvent {
            after: 0,
            step: event.step,
            time: event.time,
            unix_secs: event.unix_secs,
            what: serde_json::to_string(kind)
                .map_err(|error| error.to_string())?
                .into(),
        }),
    };
    let command = match event.event {
        EventKind::Command { verb, args, .. } => Some((verb, args)),
        _ => None,
    };
    Ok((shown, command))
}
