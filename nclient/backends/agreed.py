"""What a program has told a robot that stays so until it is told otherwise: to be told again to one opened anew.

    connect_robot  ct  conf_ls  conf_tm  conf_ir  conf_sn  conf_cp  conf_sg  ac  sp  mv (its speeds and accelerations)

Rules: the last of each kind counts, and they are told in this order: who it is, the shape of answers, safety, sensors,
motion. Nothing here moves a robot. Accelerations and speeds are kept by axis, since mv sets them so.
"""

from __future__ import annotations

from collections.abc import Iterator

from nclient.protocol.commands import Call

_FIRST = ("connect_robot", "ct", "conf_ls", "conf_tm", "conf_ir", "conf_sn", "conf_cp", "conf_sg")
_AXES = 3
_NOWHERE = 0
_MODES = {4: "ac", 5: "sp"}
"""mv's modes that set something and move nothing, and the command that sets it for all axes."""
_CALIBRATING = 2


class Agreed:
    """What has been told, newest of each kind."""

    def __init__(self) -> None:
        self._told: dict[str, Call] = {}
        self._axes: dict[str, dict[int, int]] = {name: {} for name in _MODES.values()}

    def remember(self, call: Call) -> None:
        """A call was answered."""
        if call.name == "create_robot":
            self._told["connect_robot"] = Call("connect_robot", call.args)
        elif call.name in self._axes:
            self._axes[call.name] = dict(enumerate(call.args))
        elif call.name == "mv":
            for axis, (mode, value) in enumerate(zip(call.args[::2], call.args[1::2], strict=True)):
                if mode in _MODES:
                    self._axes[_MODES[mode]][axis] = value
        elif call.name in _FIRST and call != Call("conf_cp", (_CALIBRATING,)):
            self._told[call.name] = call

    def calls(self) -> Iterator[Call]:
        """What to tell a robot that may have forgotten, in order."""
        yield from (self._told[name] for name in _FIRST if name in self._told)
        for mode, name in _MODES.items():
            values = self._axes[name]
            if len(values) == _AXES:
                yield Call(name, tuple(values[axis] for axis in range(_AXES)))
            elif values:
                pairs = [(mode, values[axis]) if axis in values else (_NOWHERE, 0) for axis in range(_AXES)]
                yield Call("mv", tuple(number for pair in pairs for number in pair))
