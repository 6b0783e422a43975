//! Controllers, and what they send and receive.

use jostle_proto::{self as proto, verbs};

use crate::swarm::frame::Frame;
use crate::swarm::membership::{Departure, Miss, Mode, News, OnTimeout};

same_variants! { Mode, verbs::Mode: Lockstep, FreeRunning }
same_variants! { OnTimeout, verbs::OnTimeout: Hold, Free, Pause }

impl From<verbs::Departure> for Departure {
    fn from(why: verbs::Departure) -> Self {
        match why {
            verbs::Departure::Left => Departure::Left,
            verbs::Departure::Lost => Departure::Lost,
            verbs::Departure::Late => Departure::Late,
        }
    }
}

impl From<Departure> for verbs::Departure {
    fn from(why: Departure) -> Self {
        match why {
            Departure::Left => verbs::Departure::Left,
            Departure::Lost => verbs::Departure::Lost,
            // Earlier clients know no other reason.
            Departure::Late | Departure::Idle => verbs::Departure::Late,
        }
    }
}

pub(super) fn news(news: verbs::News) -> News {
    let missed = news.missed.into_iter().map(|miss| Miss {
        controller: miss.controller,
        step: miss.step,
        misses: miss.misses,
    });
    let left = news.left.into_iter();
    let left = left.map(|departed| (departed.controller, departed.why.into()));
    News {
        missed: missed.collect(),
        left: left.collect(),
        removed: news.removed,
    }
}

pub(super) fn news_to_proto(news: News) -> verbs::News {
    let missed = news.missed.into_iter().map(|miss| verbs::Miss {
        controller: miss.controller,
        step: miss.step,
        misses: miss.misses,
    });
    let left = news.left.into_iter().map(|(controller, why)| {
        let why = why.into();
        verbs::Departed { controller, why }
    });
    verbs::News {
        missed: missed.collect(),
        left: left.collect(),
        removed: news.removed,
    }
}

pub fn controllers(seen: &Frame) -> proto::ControllerList {
    let controllers = seen.controllers.iter().map(|it| proto::Controller {
        controller: it.controller.clone(),
        mode: it.state.settings.mode.into(),
        ids: it.state.claims.iter().copied().collect(),
        deadline_secs: it.state.settings.deadline.as_secs_f64(),
        on_timeout: it.state.settings.on_timeout.into(),
        driving: it.state.settings.driving,
        target_step: (it.state.settings.mode == Mode::Lockstep).then_some(it.state.target),
        misses: it.state.misses,
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

pub(super) fn waiting_for(seen: &Frame) -> Vec<proto::Awaited> {
    let awaited = seen.controllers.iter().filter_map(|it| {
        Some(proto::Awaited {
            controller: it.controller.clone(),
            secs: it.waited?.as_secs_f64(),
            deadline_secs: it.state.settings.deadline.as_secs_f64(),
        })
    });
    awaited.collect()
}
