//! Converts the arguments of verbs to changes, and the outcomes of changes to results.

use jostle_physics::model::selection::Selection;
use jostle_physics::model::{Drive, body, injection};
use jostle_physics::simulation::{
    Change, ChangeKind, ChangeOutcome, Placement, SetPoints, SettingValues,
};
use jostle_proto::verbs::{
    self, Changed, Foremost, IdsResult, InformArgs, InjectArgs, Pose, Region, RemoveArgs, Select,
    SetArgs, SetResult, UninformArgs,
};

use crate::parameters::{set_args, settings, values};
use crate::value::{self, ArgsError, WireError};

/// The longest time for which individuals can be informed, in time units.
const MAX_FOR_TIME: f64 = 1e9;

/// Converts an entry of a batch.
///
/// # Errors
///
/// [`ArgsError`] names the first field that is wrong.
pub fn change(change: verbs::Change) -> Result<Change, ArgsError> {
    match change {
        verbs::Change::Set(args) => set(args),
        verbs::Change::Inform(args) => inform(args),
        verbs::Change::Uninform(args) => uninform(args),
        verbs::Change::Inject(args) => inject(args),
        verbs::Change::Remove(args) => remove(args),
    }
}

/// Returns the message of a change, which [`change`] converts to the same change.
pub fn to_proto(change: &Change) -> verbs::Change {
    match change {
        Change::Set(settings) => verbs::Change::Set(set_args(settings)),
        Change::Inform {
            selection,
            direction,
            weight,
            for_time,
        } => verbs::Change::Inform(InformArgs {
            select: selection_to_proto(selection),
            direction: *direction,
            weight: *weight,
            for_time: *for_time,
        }),
        Change::Uninform(selection) => verbs::Change::Uninform(UninformArgs {
            select: selection_to_proto(selection),
        }),
        Change::Inject { place, informed } => {
            let mut args = InjectArgs {
                direction: informed.map(|(direction, _)| direction),
                weight: informed.and_then(|(_, weight)| weight),
                ..InjectArgs::default()
            };
            match place {
                Placement::At(poses) => {
                    let poses = poses.iter();
                    args.at = Some(
                        poses
                            .map(|&body::Pose { x, y, alpha }| Pose { x, y, alpha })
                            .collect(),
                    );
                }
                Placement::Border(count) => args.count = Some(*count as u64),
                Placement::Within(count, injection::Region { x, y, radius }) => {
                    args.count = Some(*count as u64);
                    args.within = Some(Region {
                        x: *x,
                        y: *y,
                        radius: *radius,
                    });
                }
            }
            verbs::Change::Inject(args)
        }
        Change::Remove(selection) => verbs::Change::Remove(RemoveArgs {
            select: selection_to_proto(selection),
        }),
    }
}

fn selection_to_proto(selection: &Selection) -> Select {
    match selection {
        Selection::Ids(ids) => Select::Ids(ids.clone()),
        Selection::Count(count) => Select::Count(*count as u64),
        Selection::Fraction(fraction) => Select::Fraction(*fraction),
        Selection::Within { x, y, radius } => Select::Within(Region {
            x: *x,
            y: *y,
            radius: *radius,
        }),
        Selection::Informed(is_informed) => Select::Informed(*is_informed),
        Selection::Foremost { count, along } => Select::Foremost(Foremost {
            count: *count as u64,
            along: *along,
        }),
    }
}

/// `set`: new values of the given parameters; the others keep theirs.
///
/// # Errors
///
/// [`ArgsError`] if no parameter is given, or `make_room` without `pi1`. The simulation checks
/// ranges, since they depend on its state.
pub fn set(args: SetArgs) -> Result<Change, ArgsError> {
    Ok(Change::Set(settings(args)?))
}

/// `inform`: sets the direction and the weight of individuals.
///
/// # Errors
///
/// [`ArgsError`] names the first field that is wrong.
pub fn inform(args: InformArgs) -> Result<Change, ArgsError> {
    if let Some(time) = args.for_time
        && !(time > 0.0 && time <= MAX_FOR_TIME)
    {
        return Err(WireError::out_of_range("for_time", time).into());
    }
    Ok(Change::Inform {
        selection: selection(args.select)?,
        direction: args.direction,
        weight: args.weight.map(value::weight).transpose()?,
        for_time: args.for_time,
    })
}

/// `uninform`: makes individuals uninformed.
///
/// # Errors
///
/// [`ArgsError`] names the first field that is wrong.
pub fn uninform(args: UninformArgs) -> Result<Change, ArgsError> {
    Ok(Change::Uninform(selection(args.select)?))
}

/// `inject`: adds individuals where they overlap no other one.
///
/// # Errors
///
/// [`ArgsError`] unless exactly one of `count` and `at` is given, and for `within` without `count`
/// or `weight` without `direction`.
pub fn inject(args: InjectArgs) -> Result<Change, ArgsError> {
    let wrong = |field, problem| Err(ArgsError::Field { field, problem });
    if args.count == Some(0) || args.at.as_ref().is_some_and(Vec::is_empty) {
        let field = if args.at.is_none() { "count" } else { "at" };
        return wrong(field, "adds no individual: add at least one");
    }
    let place = match (args.count, args.at, args.within) {
        (Some(_), Some(_), _) => {
            return wrong("at", "and count are both given: give one of them");
        }
        (None, None, _) => {
            return wrong("count", "or at is missing: give a number or the poses");
        }
        (None, Some(_), Some(_)) => return wrong("within", "requires count: leave it out"),
        (None, Some(poses), None) => Placement::At(poses.into_iter().map(pose).collect()),
        (Some(count), None, None) => Placement::Border(value::count(count)),
        (Some(count), None, Some(region)) => {
            Placement::Within(value::count(count), self::region(region))
        }
    };
    let informed = match (args.direction, args.weight) {
        (None, Some(_)) => return wrong("weight", "requires direction: give both"),
        (None, None) => None,
        (Some(direction), weight) => Some((direction, weight.map(value::weight).transpose()?)),
    };
    Ok(Change::Inject { place, informed })
}

/// `remove`: removes individuals.
///
/// # Errors
///
/// [`ArgsError`] names the first field that is wrong.
pub fn remove(args: RemoveArgs) -> Result<Change, ArgsError> {
    Ok(Change::Remove(selection(args.select)?))
}

/// Converts a selection of individuals.
///
/// # Errors
///
/// [`WireError::OutOfRange`] for a radius below 0.
pub fn selection(select: Select) -> Result<Selection, WireError> {
    Ok(match select {
        Select::Ids(ids) => Selection::Ids(ids),
        Select::Count(number) => Selection::Count(value::count(number)),
        Select::Fraction(fraction) => Selection::Fraction(fraction),
        Select::Within(Region { x, y, radius }) => {
            if radius.is_nan() || radius < 0.0 {
                return Err(WireError::out_of_range("select.within.radius", radius));
            }
            Selection::Within { x, y, radius }
        }
        Select::Informed(is_informed) => Selection::Informed(is_informed),
        Select::Foremost(foremost) => Selection::Foremost {
            count: value::count(foremost.count),
            along: foremost.along,
        },
    })
}

/// Converts the position and heading of a body.
pub fn pose(Pose { x, y, alpha }: Pose) -> body::Pose {
    body::Pose { x, y, alpha }
}

/// Converts a disc.
pub fn region(Region { x, y, radius }: Region) -> injection::Region {
    injection::Region { x, y, radius }
}

/// Converts set-points. All columns must have the length of `ids`, and no id may occur twice.
///
/// # Errors
///
/// [`ArgsError::Field`] names the column.
pub fn set_points(set: verbs::SetPoints) -> Result<SetPoints, ArgsError> {
    let verbs::SetPoints {
        ids,
        direction,
        weight,
        turn,
        speed,
    } = set;
    let wrong = |field, problem| Err(ArgsError::Field { field, problem });
    if direction.len() != ids.len() {
        return wrong("set.direction", "must have as many numbers as ids");
    }
    if weight.as_ref().is_some_and(|it| it.len() != ids.len()) {
        return wrong("set.weight", "must have as many numbers as ids");
    }
    let fits = |column: &Option<Vec<Option<f64>>>| {
        column
            .as_ref()
            .is_none_or(|column| column.len() == ids.len())
    };
    for (field, column) in [("set.turn", &turn), ("set.speed", &speed)] {
        if !fits(column) {
            return wrong(field, "must have as many entries as ids");
        }
    }
    let entry = |column: &Option<Vec<Option<f64>>>, k: usize| column.as_ref().and_then(|it| it[k]);
    let is_driving = turn.is_some() || speed.is_some();
    let drives = is_driving.then(|| {
        let drives = (0..ids.len()).map(|k| Drive {
            turn: entry(&turn, k),
            speed: entry(&speed, k),
        });
        drives.collect()
    });
    let mut sorted = ids.clone();
    sorted.sort_unstable();
    if sorted.windows(2).any(|pair| pair[0] == pair[1]) {
        return wrong("set.ids", "contains an id twice");
    }
    Ok(SetPoints {
        ids,
        direction,
        weight,
        drives,
    })
}

/// Returns the result of one change of a batch.
pub fn changed(kind: ChangeKind, outcome: ChangeOutcome) -> Changed {
    match outcome {
        ChangeOutcome::Set {
            before,
            now,
            scaled_by,
        } => Changed::Set(set_result(&before, &now, scaled_by)),
        ChangeOutcome::Ids { ids, n } => {
            let result = ids_result(ids, n);
            match kind {
                ChangeKind::Set => unreachable!("the outcome of `set` has no ids"),
                ChangeKind::Inform => Changed::Inform(result),
                ChangeKind::Uninform => Changed::Uninform(result),
                ChangeKind::Inject => Changed::Inject(result),
                ChangeKind::Remove => Changed::Remove(result),
            }
        }
    }
}

/// Returns the result of `set`.
pub fn set_result(before: &SettingValues, now: &SettingValues, scaled_by: f64) -> SetResult {
    let of = |it: &SettingValues| {
        values(
            it.parameters,
            it.publish_every,
            &it.measures,
            it.max_idle_secs,
        )
    };
    SetResult {
        before: of(before),
        now: of(now),
        scaled_by,
        published_hz: None,
    }
}

/// Returns the result of a change of individuals.
pub fn ids_result(ids: Vec<u32>, n: usize) -> IdsResult {
    IdsResult { ids, n: n as u64 }
}
