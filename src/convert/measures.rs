//! The reply to `get/measures`.

use jostle_measures::{MAX_COSTLY_INDIVIDUALS, Measure, Past, View};
use jostle_physics::model::{State, WarmStart};
use jostle_proto as proto;

use crate::convert::error::measures::MeasuresError;
use crate::swarm::frame::Frame;

/// Evaluates the requested measures of a state; by default all that need no past and that are
/// computed for groups of this size.
pub fn measures(
    seen: &Frame,
    requested: Option<Vec<Measure>>,
) -> Result<proto::Measures, MeasuresError> {
    let n = seen.configuration.n();
    let is_too_large = |it: &Measure| it.is_too_costly(n);
    let measures = match requested {
        Some(measures) => match measures.iter().find(|it| is_too_large(it)) {
            Some(measure) => {
                return Err(MeasuresError::TooLarge {
                    measure: measure.to_string(),
                    n,
                    limit: MAX_COSTLY_INDIVIDUALS,
                });
            }
            None => measures,
        },
        None => {
            let mut all = Measure::all_of_one_state();
            all.retain(|it| !is_too_large(it));
            all
        }
    };
    let state = State {
        parameters: seen.parameters,
        seed: seen.seed,
        step: seen.stamp.step,
        configuration: seen.configuration.clone(),
        warm_start: WarmStart::default(),
    };
    let past = Past::new(0);
    let view = View::new(&state, &past);
    let value = |measure: &Measure| proto::MeasureValue {
        name: measure.to_string(),
        value: measure.evaluate(&view),
        unit: measure.definition().unit.to_owned(),
    };
    let measures = measures.iter().map(value).collect();
    Ok(proto::Measures { measures })
}
