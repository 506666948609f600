"""Without the extra `gym` its tests are not collected."""

from importlib.util import find_spec

collect_ignore_glob = ["test_*.py"] if find_spec("pettingzoo") is None else []
