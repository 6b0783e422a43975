//! The method `set`, of which the arguments are the parameters.

use super::WRITTEN;
use super::fields::Field;
use super::text::attributes;

const HEAD: &str = r#"from __future__ import annotations

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
"#;

const DOC: &str = r#"        """Changes parameters between two steps.

            swarm.set(pi3=2.0, attraction={"kind": "topological", "neighbours": 7})

        A parameter that is None does not change. Table 1 of the paper defines π1 to π4. A new π2 is
        not that of individuals that are informed already; all contact rules but `closest` require
        that no two axes cross.

        Args:
"#;

const END: &str = r#"            options: See `Options`.

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
"#;

const LAST: &str = r#"            ),
            options,
        )

    def _set(self, change: Set, options: Options) -> SetResult:
        raise NotImplementedError
"#;

/// The file with the method, of which `fields` are the arguments.
pub fn file(fields: &[Field]) -> String {
    let mut text = format!("\"\"\"The command `set`.\n\n{WRITTEN}\n\"\"\"\n\n{HEAD}");
    for Field {
        name,
        kind,
        default,
        ..
    } in fields
    {
        let kind = kind.replace("int", "SupportsIndex");
        let default = default.as_deref().unwrap_or("None");
        text += &format!("        {name}: {kind} = {default},\n");
    }
    text += "        **options: Unpack[Options],\n    ) -> SetResult:\n";
    text += DOC;
    text += &attributes(fields, 12);
    text += END;
    for Field { name, kind, .. } in fields {
        let value = match kind.starts_with("int") {
            true => format!("whole_or_none(\"{name}\", {name})"),
            false => name.clone(),
        };
        text += &format!("                {name}={value},\n");
    }
    text + LAST
}
