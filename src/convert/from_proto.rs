//! What clients send about controllers.

use jostle_proto::verbs;

use crate::swarm::membership::{Departure, Miss, Mode, News, OnTimeout};

/// Set-points that were put, in CBOR or JSON.
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

/// How a controller takes part.
pub fn mode(mode: verbs::Mode) -> Mode {
    match mode {
        verbs::Mode::Lockstep => Mode::Lockstep,
        verbs::Mode::FreeRunning => Mode::FreeRunning,
    }
}

/// What becomes of the individuals of a controller that is late.
pub fn on_timeout(on_timeout: verbs::OnTimeout) -> OnTimeout {
    match on_timeout {
        verbs::OnTimeout::Hold => OnTimeout::Hold,
        verbs::OnTimeout::Free => OnTimeout::Free,
        verbs::OnTimeout::Pause => OnTimeout::Pause,
    }
}

/// What a controller is to be told.
pub fn news(news: verbs::News) -> News {
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
