//! The paper's figures, drawn from tables of runs. The same table gives the same bytes.
//!
//! Each figure has one panel for each contact rule and time step in the table.

#![cfg_attr(
    test,
    expect(clippy::disallowed_methods, reason = "tests depend on no bit of them")
)]

mod axis;
mod chart;
mod clusters;
mod curves;
mod drift;
mod frame;
mod image;
mod intervals;
mod layout;
mod order;
mod plot;
#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod readback;
#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod reading;
mod snapshot;
mod svg;
mod text;

use jostle_results::statistics::summarise;
use jostle_results::{Measure, ResultRow};

pub use chart::{Labels, MAX_CURVES, TooManyCurves, draw_chart, remarks};
pub use image::{SaveError, save};
pub use snapshot::{Group, Member, snapshot};

/// A figure of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The paper's Figure 2: the mean order over n.
    Order,
    /// The paper's Figure 4: the times of build-up and breakdown of order, over n.
    Intervals,
    /// The paper's Figure 5: the effective size of ordered clusters over n.
    Clusters,
    /// The paper's Figure 6: the drift along the informed individuals' direction over π1.
    Drift,
}

/// An error of drawing a figure.
#[derive(Debug, thiserror::Error)]
pub enum FigureError {
    /// The table has no runs.
    #[error("draw a figure: the table has no runs")]
    Empty,
    /// The table has none of the runs that the figure shows.
    #[error("draw figure {}: it needs {needed}, and none of the {runs} runs is one", kind.number())]
    Unsuitable {
        /// The figure.
        kind: Kind,
        /// The runs that it shows.
        needed: &'static str,
        /// The number of runs in the table.
        runs: usize,
    },
    /// Commands changed the group during runs.
    #[error(
        "draw figure {}: {runs} of the runs have a protocol ([[at]] or [stop]), and the figure is of \
         runs without one: draw a column with --y", kind.number()
    )]
    Protocol {
        /// The figure.
        kind: Kind,
        /// The number of these runs.
        runs: usize,
    },
    /// The quantity of the figure is undefined for all of its runs.
    #[error("draw figure {}: {missing}", kind.number())]
    Undefined {
        /// The figure.
        kind: Kind,
        /// The reason.
        missing: &'static str,
    },
    /// A snapshot without groups, or a group without individuals.
    #[error("draw a snapshot: it needs at least one group, and in each at least one individual")]
    NoBodies,
    /// A body has no finite position or angle.
    #[error("draw a snapshot: group {group}, individual {index}: not a finite position and angle")]
    NotFinite {
        /// The index of the group, from 0.
        group: usize,
        /// The index of the individual in it, from 0.
        index: usize,
    },
    /// The elongation of a group's bodies is invalid.
    #[error("draw a snapshot: group {group}: pi1 is {pi1}, not 1 or more")]
    Elongation {
        /// The index of the group, from 0.
        group: usize,
        /// Its `pi1`.
        pi1: f64,
    },
}

impl Kind {
    /// Every figure, in the paper's order.
    pub const ALL: [Self; 4] = [Self::Order, Self::Intervals, Self::Clusters, Self::Drift];

    /// Returns the paper's number of the figure.
    pub fn number(self) -> u8 {
        match self {
            Self::Order => 2,
            Self::Intervals => 4,
            Self::Clusters => 5,
            Self::Drift => 6,
        }
    }

    /// Returns the figure with the paper's number, if any.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.number() == number)
    }
}

/// Draws a figure of `runs` as SVG. Runs that it does not show are ignored.
///
/// # Errors
///
/// [`FigureError::Empty`], [`FigureError::Unsuitable`] or [`FigureError::Undefined`] if the figure
/// would be empty; [`FigureError::Protocol`] if a run shows that it has a protocol.
pub fn draw(kind: Kind, runs: &[ResultRow]) -> Result<String, FigureError> {
    if runs.is_empty() {
        return Err(FigureError::Empty);
    }
    let protocols = runs.iter().filter(|run| has_protocol(run)).count();
    if protocols > 0 {
        let runs = protocols;
        return Err(FigureError::Protocol { kind, runs });
    }
    let mut summaries = summarise(runs);
    let needed = if kind == Kind::Drift {
        summaries.retain(|summary| summary.v_pd.is_some() && summary.condition.n > 0);
        "runs with informed individuals and a v_pd"
    } else {
        summaries.retain(|summary| summary.condition.informed == 0);
        "runs without informed individuals"
    };
    if summaries.is_empty() {
        let runs = runs.len();
        return Err(FigureError::Unsuitable { kind, needed, runs });
    }
    let plot = match kind {
        Kind::Order => order::plot(&summaries),
        Kind::Intervals => intervals::plot(&summaries),
        Kind::Clusters => clusters::plot(&summaries),
        Kind::Drift => drift::plot(&summaries),
    };
    let mut curves = plot.panels.iter().flat_map(|panel| &panel.curves);
    let shown = curves.any(|curve| curve.measured && curve.points.iter().any(Option::is_some));
    if shown {
        return Ok(plot.draw());
    }
    let missing = match kind {
        Kind::Intervals => "at no n and pi1 every run reached order",
        Kind::Clusters => "every mean speed is below v_ind, that of independent headings",
        Kind::Order | Kind::Drift => "no mean can be drawn",
    };
    Err(FigureError::Undefined { kind, missing })
}

/// Returns whether a row shows that its run has a protocol: `[stop]` has a column, and a group without
/// informed individuals at the start has a drift only if a command informs some.
fn has_protocol(run: &ResultRow) -> bool {
    let is_informed_later = run.informed == 0 && run.optional_number(Measure::V_PD).is_some();
    is_informed_later || run.extra.iter().any(|it| it.name == "stopped_at")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::path::Path;

    use super::*;
    use jostle_results::{Cell, ExtraValue, table};

    /// A stored row, in which the group was ordered for three intervals.
    pub(crate) fn sample() -> ResultRow {
        let stored = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/stored/bf41dde");
        let row = table::read(&stored.join("results/results.csv"))
            .unwrap()
            .swap_remove(0);
        assert_eq!(row.informed, 0);
        let row = with(ResultRow { n: 10, ..row }, Measure::V, 0.9);
        let row = with(row, Measure::ORDERED_INTERVALS, 3);
        let row = with(row, Measure::ORDERED_TIME, 950.0);
        let row = with(row, Measure::UNORDERED_INTERVALS, 2);
        with(row, Measure::UNORDERED_TIME, 50.0)
    }

    pub(crate) fn with(mut row: ResultRow, measure: Measure, value: impl Into<Cell>) -> ResultRow {
        row.set(measure, value.into());
        row
    }

    fn series() -> Vec<ResultRow> {
        let mut runs = Vec::new();
        for (contacts, dt) in [("endpoints", 0.02), ("closest", 0.1)] {
            for (n, v) in [(3, 0.99), (10, 0.95), (50, 0.5)] {
                for v in [v, v - 0.01] {
                    for informed in [0, n / 5] {
                        let v_pd = (informed > 0).then_some(v / 2.0);
                        let row = ResultRow {
                            contacts: contacts.to_owned(),
                            dt,
                            n,
                            informed,
                            ..sample()
                        };
                        runs.push(with(with(row, Measure::V, v), Measure::V_PD, v_pd));
                    }
                }
            }
        }
        runs
    }

    #[test]
    fn the_same_table_gives_the_same_picture_with_a_panel_for_each_rule() {
        for kind in Kind::ALL {
            let one = draw(kind, &series()).unwrap();
            assert_eq!(one, draw(kind, &series()).unwrap());
            assert!(one.contains(">endpoints, dt = 0.02<"), "{one}");
            assert!(one.contains(">closest, dt = 0.1<"), "{one}");
            assert!(!one.contains("NaN") && !one.contains("inf\""), "{one}");
        }
    }

    #[test]
    fn a_single_run_is_enough() {
        let mut run = sample();
        for kind in [Kind::Order, Kind::Intervals, Kind::Clusters] {
            let picture = draw(kind, &[run.clone()]).unwrap();
            assert!(!picture.contains("NaN"), "{picture}");
        }
        run.informed = 1;
        let run = with(run, Measure::V_PD, -0.1);
        assert!(draw(Kind::Drift, &[run]).is_ok());
    }

    #[test]
    fn figure_errors_name_the_required_runs() {
        assert!(matches!(draw(Kind::Order, &[]), Err(FigureError::Empty)));
        let unsuitable = draw(Kind::Drift, &[sample()]).unwrap_err();
        let text = unsuitable.to_string();
        assert!(
            text.contains("figure 6") && text.contains("informed"),
            "{text}"
        );

        let never = with(sample(), Measure::V, 0.01);
        let never = with(never, Measure::ORDERED_INTERVALS, 0);
        for kind in [Kind::Intervals, Kind::Clusters] {
            let undefined = draw(kind, std::slice::from_ref(&never)).unwrap_err();
            assert!(
                matches!(undefined, FigureError::Undefined { .. }),
                "{undefined}"
            );
        }
    }

    #[test]
    fn runs_with_a_protocol_are_rejected_by_every_figure() {
        let mut stopped = sample();
        stopped.extra.push(ExtraValue {
            name: "stopped_at".to_owned(),
            value: None,
        });
        let informed_later = with(sample(), Measure::V_PD, 0.3);
        for kind in Kind::ALL {
            for run in [&stopped, &informed_later] {
                let error = draw(kind, &[sample(), run.clone()])
                    .unwrap_err()
                    .to_string();
                assert!(error.contains("1 of the runs have a protocol"), "{error}");
                assert!(error.contains("with --y"), "{error}");
            }
        }
    }

    #[test]
    fn figures_have_the_papers_numbers() {
        for kind in Kind::ALL {
            assert_eq!(Kind::from_number(kind.number()), Some(kind));
        }
        assert_eq!(Kind::from_number(3), None);
    }
}
