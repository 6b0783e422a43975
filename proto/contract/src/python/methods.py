class AuditLine:
    @property
    def when(self) -> datetime:
        """`unix_secs` as an aware datetime, UTC."""
        return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=self.unix_secs)


class Progress:
    def _summary(self) -> str:
        """The same as a text, without the share."""
        left = "" if self.left_secs is None or self.is_over else f", {self.left_secs:.0f} s left"
        faulted = f", {self.faulted} faulted" if self.faulted else ""
        why = f": {self.message}" if self.message else ""
        runs = f"{self.finished} of {self.runs} runs"
        if self.model_version is not None:
            runs += f" of model version {self.model_version}"
        if self.start_model_version is not None:
            runs += f", from a state of model version {self.start_model_version}"
        return f"{self.phase}, {runs}{faulted}{left}{why}"

    def _repr_html_(self) -> str:
        return bar_html(self.share, f"{self.name} {100 * self.share:z.0f} %, {self._summary()}")

    @property
    def is_over(self) -> bool:
        """Whether it has ended."""
        return self.phase in ("finished", "cancelled", "failed")


class WhoAmI:
    def may(self, verb: str) -> bool:
        """Whether `verb` is permitted, such as `"pause"` or `"create"`."""
        return verb in self.verbs or verb in self.node_verbs
