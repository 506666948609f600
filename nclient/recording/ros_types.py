"""Messages as objects of a library, from the type descriptions of rosbags: the one table of ROS types.

A message is made by `MessageBuilder.build`:

    {"data": 3}, "std_msgs/msg/UInt32" ──> UInt32 of rosbags, or UInt32_ of Cyclone DDS
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

FieldType = tuple[Any, Any]
"""Kind and argument: (BASE, (name, length)), (NAME, type) or (ARRAY or SEQUENCE, (FieldType, length))."""
_DEFAULTS: Final[Mapping[str, Any]] = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}


class MessageBuilder:
    """Makes objects of messages.

    Parameters
    ----------
    store : type store of rosbags, with the fields of each type.
    class_of : returns the class of a type by its name, such as nav_msgs/msg/Odometry.
    array_of : returns the array for a list of numbers and the name of their type; None leaves lists.
    """

    def __init__(
        self,
        store: Typestore,
        class_of: Callable[[str], Callable[..., Any]],
        array_of: Callable[[Sequence[Any], str], Any] | None = None,
    ) -> None:
        self._store = store
        self._class_of = class_of
        self._array_of = array_of

    def build(self, type_name: str, message: Mapping[str, Any]) -> Any:
        """Return the object of a message; fields that it leaves out are 0 or empty, and others are ignored."""
        _, fields = self._store.fielddefs[type_name]
        return self._class_of(type_name)(**{name: self._value(kind, message.get(name)) for name, kind in fields})

    def _value(self, field: FieldType, value: Any) -> Any:
        match field:
            case Nodetype.BASE, (name, _):
                return _DEFAULTS.get(name, 0) if value is None else value
            case Nodetype.NAME, name:
                return self.build(name, value or {})
        # Arrays: of numbers as they are, since a map has a million of them.
        kind, (item, length) = field
        if value is None:
            value = [self._value(item, None)] * length if kind == Nodetype.ARRAY else []
        if item[0] == Nodetype.BASE and item[1][0] != "string":
            return value if self._array_of is None else self._array_of(value, item[1][0])
        return [self._value(item, one) for one in value]
