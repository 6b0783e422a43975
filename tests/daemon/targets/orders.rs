//! Requests as the daemon parses them to commands, or rejects them.

use std::time::Duration;

use jostle_conditions::Condition;
use jostle_convert::Place;
use jostle_convert::parameters::set_args;
use jostle_physics::simulation::{Change, Placement, Settings, Spec, Start};
use jostle_proto::verbs::CreateArgs;
use jostle_proto::{Error, ErrorCode, Request, keys};
use jostled::convert::commands::{self, CommandError, create};
use jostled::swarm::command::{Command, Until};
use jostled::swarm::handle::CommandMessage;
use jostled::swarm::registry::Limits;
use jostled::swarm::watch::Action;
use serde_json::Value;

const LIMITS: Limits = Limits {
    max_individuals: 2000,
    max_swarms: 16,
    max_memory_bytes: 1 << 30,
    max_hz: 50,
};

/// The number of first bytes that differ. A new verb is the next in [`keys::SWARM_VERBS`], so that the first
/// byte of the files in `fuzz/corpus/orders` keeps its meaning.
pub const FIRST_BYTES: u8 = 64;

/// The first byte of a spec.
pub const CREATE: u8 = 62;

/// The first byte chooses the verb: its position in [`keys::SWARM_VERBS`]; [`CREATE`] has a spec; the others
/// have an unknown verb. A parsed command is in range as far as is known without a
/// swarm; a rejection has a short message and a code of the sender's fault.
pub fn check(data: &[u8]) {
    let [verb, payload @ ..] = data else {
        return;
    };
    let request = match Request::from_json(payload) {
        Ok(request) => request,
        Err(error) => return is_worded(&error.into()),
    };
    let first = verb % FIRST_BYTES;
    match keys::SWARM_VERBS.get(usize::from(first)) {
        Some(verb) => {
            let read = commands::read(verb, &request);
            match read.and_then(|(message, _)| Ok((message, commands::timeout(&request)?))) {
                Ok((message, timeout)) => is_in_range(&message, timeout),
                Err(error) => is_worded(&error),
            }
        }
        None if first == CREATE => {
            let args: Result<CreateArgs, _> = request.args();
            match args
                .map_err(CommandError::from)
                .and_then(|args| create::spec(&args, LIMITS))
            {
                Ok(recipe) => can_be_built(&recipe),
                Err(error) => is_worded(&error),
            }
        }
        None => {
            // An unknown verb, with any payload.
            let verb: String = String::from_utf8_lossy(payload).into_owned();
            let error = commands::read(&verb, &request).err();
            is_worded(&error.expect("no JSON is a verb"));
        }
    }
}

fn is_worded(error: &CommandError) {
    let Error {
        code,
        message,
        details,
        ..
    } = error.to_wire(Some(3), &Place::default());
    let codes = [
        ErrorCode::InvalidArgument,
        ErrorCode::NotFound,
        ErrorCode::ResourceExhausted,
    ];
    assert!(codes.contains(&code), "{error:?}");
    assert!(
        !message.is_empty() && message.chars().count() < 1000,
        "{message}"
    );
    let details = serde_json::to_string(&details).expect("details are JSON");
    assert!(details.len() < 2000, "{details}");
}

fn is_in_range(message: &CommandMessage, timeout: Duration) {
    assert!(timeout.as_secs_f64() > 0.0 && timeout.as_secs() <= 3600);
    let (command, sender) = (&message.command, &message.sender);
    for label in [&sender.client, &sender.request_id].into_iter().flatten() {
        assert!(
            label.len() <= 256 && !label.chars().any(char::is_control),
            "{label:?}"
        );
    }
    let whole = 0..1 << 53;
    assert!(
        message
            .when
            .at_step
            .is_none_or(|step| whole.contains(&step))
    );
    let rate = |rate: f64| rate > 0.0 && rate <= 1e6;
    match command {
        Command::Run { until, rate: new } => {
            assert!(new.is_none_or(|new| new.is_none_or(rate)), "{command:?}");
            match until {
                Some(Until::Step(step)) => assert!(whole.contains(step)),
                Some(Until::Time(time)) => assert!((0.0..=1e12).contains(time)),
                None => {}
            }
        }
        Command::Step(steps) => assert!((1..=1_000_000_000).contains(steps)),
        Command::Reset(seed) => assert!(seed.is_none_or(|seed| whole.contains(&seed))),
        Command::Change(change) => can_be_tried(change),
        Command::Batch { changes, .. } => {
            assert!((1..=256).contains(&changes.len()));
            changes.iter().for_each(can_be_tried);
        }
        Command::Join(options) => {
            let secs = options.settings.deadline.as_secs_f64();
            assert!(keys::is_name(&options.controller) && secs > 0.0 && secs <= 60.0);
        }
        Command::Advance {
            controller,
            steps,
            set,
        } => {
            assert!(keys::is_name(controller) && (1..=1_000_000_000).contains(steps));
            if let Some(set) = set {
                let weights = set.weight.as_ref().map_or(set.ids.len(), Vec::len);
                assert_eq!([set.direction.len(), weights], [set.ids.len(); 2]);
            }
        }
        Command::Leave(controller) => assert!(keys::is_name(controller)),
        Command::Watch(watch) => {
            let text = watch.condition.to_string();
            assert_eq!(
                Condition::parse(&text).as_ref(),
                Ok(&watch.condition),
                "{text}"
            );
            if let Action::Batch(changes, _) = &watch.action {
                assert!((1..=256).contains(&changes.len()));
                changes.iter().for_each(can_be_tried);
            }
        }
        Command::Deadline(_)
        | Command::Lost(_)
        | Command::Idle(_)
        | Command::Control { .. }
        | Command::Fired(_) => {
            panic!("no request is parsed to {command:?}")
        }
        Command::Annotate => {
            let args: Value = serde_json::from_str(&sender.args).unwrap();
            let text = args["text"].as_str().unwrap();
            assert!((1..=1000).contains(&text.chars().count()), "{text:?}");
            assert!(!text.chars().any(char::is_control), "{text:?}");
        }
        Command::Pause | Command::Protect(_) | Command::Delete | Command::Unwatch(_) => {}
    }
}

fn can_be_tried(change: &Change) {
    let weight = |weight: f64| weight > 0.0;
    match change {
        Change::Set(settings) => {
            // In JSON a number that is not finite is null, and what is not given is left out.
            let args = serde_json::to_string(&set_args(settings)).unwrap();
            assert!(!args.contains("null"), "{args}");
            let nothing = Settings {
                make_room: settings.make_room,
                ..Settings::default()
            };
            assert_ne!(*settings, nothing);
            let often = 1..=1_000_000_000;
            assert!(
                settings
                    .publish_every
                    .is_none_or(|steps| often.contains(&steps))
            );
        }
        Change::Inform {
            direction,
            weight: own,
            for_time,
            ..
        } => {
            assert!(direction.is_finite() && own.is_none_or(weight));
            assert!(for_time.is_none_or(|time| time > 0.0 && time <= 1e9));
        }
        Change::Inject { place, informed } => {
            match place {
                Placement::At(poses) => assert!(!poses.is_empty()),
                Placement::Border(count) | Placement::Within(count, _) => assert!(*count > 0),
            }
            assert!(informed.is_none_or(|(direction, own)| {
                direction.is_finite() && own.is_none_or(weight)
            }));
        }
        Change::Uninform(_) | Change::Remove(_) => {}
    }
}

fn can_be_built(recipe: &Spec) {
    assert!((1..=LIMITS.max_individuals).contains(&recipe.n));
    assert!(recipe.seed < 1 << 53 && recipe.publish_every > 0);
    if let Start::Given { x, y, alpha } = &recipe.start {
        assert_eq!([x.len(), y.len(), alpha.len()], [recipe.n; 3]);
    }
}
