//! Controllers, and what they send and receive.

use jostle_proto::{self as proto, verbs};

use crate::swarm::frame::Frame;
use crate::swarm::membership::{Departure, Miss, Mode, News, OnTimeout};

/// Parses set-points in CBOR or JSON.
///
/// # Errors
///
/// What is wrong with them.
pub fn control(bytes: &[u8], is_cbor: bool) -> Result<verbs::Control, String> {
    match is_cbor {
        true => ciborium::from_reader(bytes).map_err(|error| error.to_string()),
        false => serde_json::from_slice(bytes).map_err(|error| error.to_string()),
    }
}

/// Converts the mode of a controller.
pub fn mode(mode: verbs::Mode) -> Mode {
    match mode {
        verbs::Mode::Lockstep => Mode::Lockstep,
        verbs::Mode::FreeRunning => Mode::FreeRunning,
    }
}

/// Converts what happens to the individuals of a late controller.
pub fn on_timeout(on_timeout: verbs::OnTimeout) -> OnTimeout {
    match on_timeout {
        verbs::OnTimeout::Hold => OnTimeout::Hold,
        verbs::OnTimeout::Free => OnTimeout::Free,
        verbs::OnTimeout::Pause => OnTimeout::Pause,
    }
}

/// Converts the news of a controller.
pub(super) fn news(news: verbs::News) -> News {
    let missed = news.missed.into_iter().map(|miss| Miss {
        controller: miss.controller,
        step: miss.step,
        misses: miss.misses,
    });
    let left = news.left.into_iter().map(|departed| {
        let why = match departed.why {
            verbs::Departure::Left => Departure::Left,
            verbs::Departure::Lost => Departure::Lost,
            verbs::Departure::Late => Departure::Late,
        };
        (departed.controller, why)
    });
    News {
        missed: missed.collect(),
        left: left.collect(),
        removed: news.removed,
    }
}

/// Converts the mode of a controller.
pub(super) fn mode_to_proto(mode: Mode) -> verbs::Mode {
    match mode {
        Mode::Lockstep => verbs::Mode::Lockstep,
        Mode::FreeRunning => verbs::Mode::FreeRunning,
    }
}

/// Converts what happens to the individuals of a late controller.
pub(super) fn on_timeout_to_proto(on_timeout: OnTimeout) -> verbs::OnTimeout {
    match on_timeout {
        OnTimeout::Hold => verbs::OnTimeout::Hold,
        OnTimeout::Free => verbs::OnTimeout::Free,
        OnTimeout::Pause => verbs::OnTimeout::Pause,
    }
}

/// Converts the news of a controller.
pub(super) fn news_to_proto(news: News) -> verbs::News {
    let missed = news.missed.into_iter().map(|miss| verbs::Miss {
        controller: miss.controller,
        step: miss.step,
        misses: miss.misses,
    });
    let left = news
        .left
        .into_iter()
        .map(|(controller, why)| verbs::Departed {
            controller,
            why: match why {
                Departure::Left => verbs::Departure::Left,
                Departure::Lost => verbs::Departure::Lost,
                Departure::Late => verbs::Departure::Late,
            },
        });
    verbs::News {
        missed: missed.collect(),
        left: left.collect(),
        removed: news.removed,
    }
}

/// Returns the list of the joined controllers.
pub fn controllers(seen: &Frame) -> proto::ControllerList {
    let controllers = seen.controllers.iter().map(|it| proto::Controller {
        controller: it.controller.clone(),
        mode: mode_to_proto(it.mode),
        ids: it.ids.clone(),
        deadline_secs: it.deadline.as_secs_f64(),
        on_timeout: on_timeout_to_proto(it.on_timeout),
        driving: it.driving,
        target_step: it.target,
        misses: it.misses,
        waited_secs: it.waited.map(|waited| waited.as_secs_f64()),
        puts: proto::Puts {
            applied: it.puts.applied,
            stale: it.puts.stale,
            overtaken: it.puts.overtaken,
            refused: it.puts.rejected,
        },
    });
    proto::ControllerList {
        controllers: controllers.collect(),
    }
}

/// Returns the controllers for which the swarm waits.
pub(super) fn waiting_for(seen: &Frame) -> Vec<proto::Awaited> {
    let awaited = seen.controllers.iter().filter_map(|it| {
        Some(proto::Awaited {
            controller: it.controller.clone(),
            secs: it.waited?.as_secs_f64(),
            deadline_secs: it.deadline.as_secs_f64(),
        })
    });
    awaited.collect()
}
