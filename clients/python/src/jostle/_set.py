"""The command `set`.

Written by `cargo run --release -p jostle-contract`; not by hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, SupportsIndex, Unpack

from ._arguments import whole_or_none
from ._changes import Set
from ._options import Options
from ._wire import SetResult


class SetCommand:
    """The part of a `Swarm` that changes parameters."""

    def set(
        self,
        *,
        pi1: float | None = None,
        pi2: float | None = None,
        pi3: float | None = None,
        pi4: float | None = None,
        contacts: str | None = None,
        stepping: str | None = None,
        relinearise: SupportsIndex | None = None,
        attraction: dict[str, Any] | None = None,
        noise: float | None = None,
        publish_every: SupportsIndex | None = None,
        measures: Sequence[str] | None = None,
        max_idle_secs: float | None = None,
        make_room: bool = False,
        **options: Unpack[Options],
    ) -> SetResult:
        """Changes parameters between two steps.

            swarm.set(pi3=2.0, attraction={"kind": "topological", "neighbours": 7})

        A parameter that is None does not change. Table 1 of the paper defines π1 to π4. A new π2 is
        not that of individuals that are informed already; all contact rules but `closest` require
        that no two axes cross.

        Args:
            pi1: Length over width of a body: 1 (a disc) to 32.
            pi2: Weight of individuals that are informed without a weight: 0 to 10⁶.
            pi3: Body size over turning radius: above 0, to 10⁶.
            pi4: Translational over rotational drag: above 0, to 10⁶.
            contacts: Which contacts of a pair constrain a step: `endpoints`; `closest`, only the
                one with the smallest gap; or, for comparison, `clamped`, which adds redundant ones.
            stepping: What a contact limits: `position`, the gap after the step, or `velocity`, the
                speed at which touching bodies approach each other.
            relinearise: Number of further programs that a step solves about the result of the last
                one: 0, or 1, which leaves less overlap and requires `position`.
            attraction: The law of attraction: `{"kind": "all"}` is eq. (4), which an `accuracy`
                makes faster from some thousand individuals on; others are `voronoi`, `metric` with
                a `radius` in body sizes, `topological` with a number of `neighbours`, and `power`
                with an `exponent`.
            noise: Intensity of white noise on the turning rate (squared angle over time): 0 to 10⁶.
                In free speed / body size.
            publish_every: Number of steps between two published states: 1 or more.
            measures: The measures in each published order, such as `milling`, at most 16 that need
                no earlier state; none if empty.
            max_idle_secs: Remove a controller in lock-step for which the swarm has waited so many
                seconds, and which has sent nothing meanwhile: 0.1 to 10⁶; 0 is no limit, as in a
                new swarm.
            make_room: With `pi1`: scale all positions about the centroid by the smallest factor
                that lets longer bodies fit.
            options: See `Options`.

        Returns:
            The values before and after, and the factor of `make_room`.

        Raises:
            InvalidArgument: A value is out of range, or no parameter is given.
            IncorrectState: The swarm is faulted, or axes cross and the contact rule forbids that.
            ResourceExhausted: Longer bodies would overlap; see `make_room`. Or the group is too
                large for a measure.
        """
        return self._set(
            Set(
                pi1=pi1,
                pi2=pi2,
                pi3=pi3,
                pi4=pi4,
                contacts=contacts,
                stepping=stepping,
                relinearise=whole_or_none("relinearise", relinearise),
                attraction=attraction,
                noise=noise,
                publish_every=whole_or_none("publish_every", publish_every),
                measures=measures,
                max_idle_secs=max_idle_secs,
                make_room=make_room,
            ),
            options,
        )

    def _set(self, change: Set, options: Options) -> SetResult:
        raise NotImplementedError
