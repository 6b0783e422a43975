//! The reply to `get/measures`.

use jostle_convert::MeasuresError;
use jostle_measures::{Measure, Past, View, histograms};
use jostle_proto as proto;

use crate::convert::commands::measures::{HistogramKind, Requested};
use crate::swarm::frame::Frame;

/// Evaluates the requested measures of a state; by default all that need no past and that are
/// computed for groups of this size.
pub fn measures(seen: &Frame, requested: Requested) -> Result<proto::Measures, MeasuresError> {
    let n = seen.configuration.n();
    let requested = match requested {
        Requested::Measures(requested) => requested,
        Requested::Histogram { kind, bins, max } => {
            return Ok(proto::Measures {
                measures: Vec::new(),
                histogram: Some(histogram(seen, kind, bins, max)?),
            });
        }
    };
    let measures = match requested {
        Some(measures) => {
            measures.iter().try_for_each(|it| it.check_size(n))?;
            measures
        }
        None => {
            let mut all = Measure::all_of_one_state();
            all.retain(|it| !it.is_too_costly(n));
            all
        }
    };
    let state = seen.state();
    let past = Past::new(0);
    let view = View::new(&state, &past);
    let value = |measure: &Measure| proto::MeasureValue {
        name: measure.to_string(),
        value: measure.evaluate(&view),
        unit: measure.definition().unit.to_owned(),
    };
    let measures = measures.iter().map(value).collect();
    Ok(proto::Measures {
        measures,
        histogram: None,
    })
}

fn histogram(
    seen: &Frame,
    kind: HistogramKind,
    bins: usize,
    max: f64,
) -> Result<proto::Histogram, MeasuresError> {
    let configuration = &seen.configuration;
    let name = kind.name();
    if configuration.n() > histograms::MAX_INDIVIDUALS {
        let n = configuration.n();
        return Err(MeasuresError::TooLarge { name, n });
    }
    let (found, unit) = match kind {
        HistogramKind::PairCorrelation => {
            let area = histograms::hull_area(configuration);
            let area = area.ok_or(MeasuresError::NoArea)?;
            let found = histograms::pair_correlation(configuration, bins, max, area);
            (found, "1")
        }
        HistogramKind::NeighbourDensity => {
            let found = histograms::neighbour_density(configuration, bins, max);
            (found, "individuals/body size²")
        }
    };
    let found = found?;
    Ok(proto::Histogram {
        name: name.to_owned(),
        unit: unit.to_owned(),
        edges: found.edges,
        counts: found.counts,
        values: found.values,
    })
}
