//! The parameters of a swarm: one row each, from which the messages that have them are made.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::usual::{linear, logarithmic};
use crate::walk::lenient;
use crate::{Attraction, ContactRule, LARGEST_WHOLE, Start, Stepping};

/// Maximum number of measures in a published order.
pub const MAX_PUBLISHED_MEASURES: usize = 16;

/// What a rate can be.
pub(crate) const RATE_RANGE: &str =
    "a number above 0, at most 1e6, or null for as fast as possible";

/// Makes [`Spec`], [`SetArgs`] and [`ParameterValues`]. A row is a field of the spec, in its order:
///
/// ```text
/// /// What it is, with its range.
/// #[serde(its default)] #[schemars(its range, unit, and the commands that change it)] #[reply(…)]
/// name: Type,
/// ```
///
/// A `live` row is also an optional field of the arguments of `set`, with the same range, and a field of
/// the values in replies. `#[reply(…)]` are the attributes of serde there: a row that is added later
/// needs `default`, since recordings of earlier versions lack it.
macro_rules! parameters {
    (
        $(
            fixed { $(
                $(#[doc = $fixed_doc:literal])+
                $(#[serde($($fixed_serde:tt)+)])?
                $(#[schemars($($fixed_schema:tt)+)])?
                $fixed:ident: $Fixed:ty,
            )+ }
            live { $(
                $(#[doc = $doc:literal])+
                $(#[serde($($serde:tt)+)])?
                $(#[schemars($($schema:tt)+)])?
                $(#[reply($($reply:tt)+)])?
                $live:ident: $Live:ty,
            )+ }
        )+
        last { $($last:tt)+ }
    ) => {
        /// The spec of a swarm: equal specs give equal states, bit for bit.
        ///
        /// Lengths are in body sizes, speeds in free speeds, times in their quotient. Table 1 of the paper
        /// defines π1 to π4. Only `n` is required.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct Spec {
            $(
                $(
                    $(#[doc = $fixed_doc])+
                    $(#[serde($($fixed_serde)+)])?
                    $(#[schemars($($fixed_schema)+)])?
                    pub $fixed: $Fixed,
                )+
                $(
                    $(#[doc = $doc])+
                    $(#[serde($($serde)+)])?
                    $(#[schemars($($schema)+)])?
                    pub $live: $Live,
                )+
            )+
            $($last)+
        }

        /// Changes the given parameters, at least one. A new `pi2` is not that of individuals informed
        /// before; `contacts` other than `closest` require that no axes cross.
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct SetArgs {
            $($(
                $(#[doc = $doc])+
                #[serde(default, skip_serializing_if = "Option::is_none")]
                $(#[schemars($($schema)+)])?
                pub $live: Option<$Live>,
            )+)+
            /// Remove a controller in lock-step for which the swarm has waited so many seconds, and which
            /// has sent nothing meanwhile: 0.1 to 10⁶; 0 is no limit, as in a new swarm.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            #[schemars(
                range(min = 0.0, max = 1e6),
                extend("x-range" = "0 for no limit, or a number from 0.1 to 1e6")
            )]
            pub max_idle_secs: Option<f64>,
            /// The measures in each published order, such as `milling`, at most 16 that need no earlier
            /// state; none if empty.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            #[schemars(length(max = MAX_PUBLISHED_MEASURES))]
            pub measures: Option<Vec<String>>,
            /// With `pi1`: scale all positions about the centroid by the smallest factor that lets longer
            /// bodies fit.
            #[serde(default)]
            pub make_room: bool,
        }

        impl SetArgs {
            /// What is wrong with arguments that have no parameter.
            pub const NONE: &str = concat!(
                "has no parameter: give ",
                $($(stringify!($live), ", ",)+)+
                "measures or max_idle_secs"
            );
        }

        /// The values of the parameters that commands can change.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        pub struct ParameterValues {
            $($(
                $(#[doc = $doc])+
                $(#[serde($($reply)+)])?
                pub $live: $Live,
            )+)+
            /// The measures in each published order; left out without any.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub measures: Option<Vec<String>>,
            /// Seconds that the swarm waits for a controller in lock-step that sends nothing; left out without a
            /// limit.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            pub max_idle_secs: Option<f64>,
        }

        impl Spec {
            /// The spec with these fields and these values.
            pub fn of(
                $($($fixed: $Fixed,)+)+
                values: ParameterValues,
                rate: Option<f64>,
            ) -> Self {
                Spec {
                    $($($fixed,)+ $($live: values.$live,)+)+
                    measures: values.measures,
                    rate,
                }
            }

            /// The values at the start.
            pub fn values(&self) -> ParameterValues {
                ParameterValues {
                    $($($live: self.$live,)+)+
                    measures: self.measures.clone(),
                    max_idle_secs: None,
                }
            }
        }
    };
}

parameters! {
    fixed {
        /// The number of individuals: 1 to the daemon's limit; in a spec the number at the start.
        #[schemars(
            range(min = 1),
            extend(
                "x-range" = "a whole number from 1 to the daemon's max_individuals",
                "x-unit" = "individuals",
                "x-usual" = logarithmic(3.0, 74.0),
                "x-changed-by" = ["inject", "remove"]
            )
        )]
        n: u64,
    }
    live {
        /// Length over width of a body: 1 (a disc) to 32.
        #[serde(default = "default::pi1")]
        #[schemars(
            range(min = 1.0, max = 32.0),
            extend("x-unit" = "1", "x-usual" = logarithmic(1.0, 8.0), "x-changed-by" = ["set"])
        )]
        pi1: f64,
        /// Weight of individuals that are informed without a weight: 0 to 10⁶.
        #[serde(default = "default::pi2")]
        #[schemars(
            range(min = 0.0, max = 1e6),
            extend("x-unit" = "1", "x-usual" = linear(0.0, 1.0), "x-changed-by" = ["set"])
        )]
        pi2: f64,
        /// Body size over turning radius: above 0, to 10⁶.
        #[serde(default = "default::pi3")]
        #[schemars(
            range(max = 1e6),
            extend("exclusiveMinimum" = 0, "x-unit" = "1", "x-usual" = logarithmic(0.1, 10.0), "x-changed-by" = ["set"])
        )]
        pi3: f64,
        /// Translational over rotational drag: above 0, to 10⁶.
        #[serde(default = "default::pi4")]
        #[schemars(
            range(max = 1e6),
            extend("exclusiveMinimum" = 0, "x-unit" = "1", "x-usual" = logarithmic(1.0, 100.0), "x-changed-by" = ["set"])
        )]
        pi4: f64,
    }
    fixed {
        /// The time step: above 0, and so short that no point of a body's axis travels further than a
        /// body's width.
        #[serde(default = "default::dt")]
        #[schemars(
            range(max = 1.0),
            extend(
                "exclusiveMinimum" = 0,
                "x-range" = "a number above 0, at most 2r / (1 + h ω): 0.02 fits most swarms",
                "x-unit" = "body size / free speed",
                "x-usual" = logarithmic(0.005, 0.1)
            )
        )]
        dt: f64,
    }
    live {
        /// Which contacts of a pair constrain a step: `endpoints`; `closest`, only the one with the
        /// smallest gap; or, for comparison, `clamped`, which adds redundant ones.
        #[serde(default)]
        #[schemars(extend("x-unit" = "1", "x-changed-by" = ["set"]))]
        contacts: ContactRule,
        /// What a contact limits: `position`, the gap after the step, or `velocity`, the speed at which
        /// touching bodies approach each other.
        #[serde(default)]
        #[schemars(extend("x-unit" = "1", "x-changed-by" = ["set"]))]
        stepping: Stepping,
        /// Number of further programs that a step solves about the result of the last one: 0, or 1,
        /// which leaves less overlap and requires `position`.
        #[serde(default)]
        #[schemars(range(max = 1), extend("x-unit" = "1", "x-changed-by" = ["set"]))]
        relinearise: u8,
    }
    fixed {
        /// The seed of all random draws: 0 to 2⁵³ - 1.
        #[serde(default)]
        #[schemars(range(max = LARGEST_WHOLE), extend("x-unit" = "1", "x-changed-by" = ["reset"]))]
        seed: u64,
        /// Where the individuals begin: in a `disc`, or at `given` poses.
        #[serde(default)]
        start: Start,
    }
    live {
        /// The law of attraction: `{"kind": "all"}` is eq. (4), which an `accuracy` makes faster from some
        /// thousand individuals on; others are `voronoi`, `metric` with a `radius` in body sizes,
        /// `topological` with a number of `neighbours`, and `power` with an `exponent`.
        #[serde(default)]
        #[schemars(extend("x-unit" = "1", "x-changed-by" = ["set"]))]
        #[reply(deserialize_with = "lenient")]
        attraction: Attraction,
        /// Intensity of white noise on the turning rate (squared angle over time): 0 to 10⁶.
        #[serde(default)]
        #[schemars(
            range(min = 0.0, max = 1e6),
            extend("x-unit" = "free speed / body size", "x-usual" = linear(0.0, 2.0), "x-changed-by" = ["set"])
        )]
        noise: f64,
        /// Number of steps between two published states: 1 or more.
        #[serde(default = "default::publish_every")]
        #[schemars(
            range(min = 1, max = 1_000_000_000),
            extend("x-unit" = "steps", "x-usual" = logarithmic(1.0, 100.0), "x-changed-by" = ["set"])
        )]
        publish_every: u64,
    }
    last {
        /// The measures in each published order, such as `milling`, at most 16 that need no earlier
        /// state; no measures if left out.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        #[schemars(length(max = MAX_PUBLISHED_MEASURES), extend("x-unit" = "1", "x-changed-by" = ["set"]))]
        pub measures: Option<Vec<String>>,
        /// Time units per second of wall clock; `null` is as fast as possible.
        #[serde(default = "default::rate")]
        #[schemars(
            range(max = 1e6),
            extend(
                "exclusiveMinimum" = 0,
                "x-range" = RATE_RANGE,
                "x-unit" = "time units / s",
                "x-changed-by" = ["run"]
            )
        )]
        pub rate: Option<f64>,
    }
}

impl Spec {
    /// The spec of `n` individuals with everything else left out.
    pub fn new(n: u64) -> Self {
        Spec {
            n,
            pi1: default::pi1(),
            pi2: default::pi2(),
            pi3: default::pi3(),
            pi4: default::pi4(),
            dt: default::dt(),
            contacts: ContactRule::default(),
            stepping: Stepping::default(),
            relinearise: 0,
            seed: 0,
            start: Start::default(),
            attraction: Attraction::default(),
            noise: 0.0,
            publish_every: default::publish_every(),
            measures: None,
            rate: default::rate(),
        }
    }
}

/// The defaults of Table 1 and of the service.
mod default {
    pub(super) fn pi1() -> f64 {
        4.0
    }
    pub(super) fn pi2() -> f64 {
        0.5
    }
    pub(super) fn pi3() -> f64 {
        1.0
    }
    pub(super) fn pi4() -> f64 {
        10.0
    }
    pub(super) fn dt() -> f64 {
        0.02
    }
    pub(super) fn publish_every() -> u64 {
        5
    }
    #[expect(clippy::unnecessary_wraps, reason = "the field it fills is optional")]
    pub(super) fn rate() -> Option<f64> {
        Some(1.0)
    }
}
