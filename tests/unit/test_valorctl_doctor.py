"""What ``valorctl doctor`` says of keys that others could read."""

from __future__ import annotations

from pathlib import Path

import pytest

import bifrost
from valor_common.instance import Instance
from valorctl import checks


@pytest.mark.parametrize(("name", "mode"), [("client.key", 0o640), ("server.key", 0o604), ("", 0o750)])
def test_keys_that_others_can_read_are_complained_of(tmp_path: Path, name: str, mode: int) -> None:
    instance = Instance("doctored", tmp_path)
    [check] = [each for each in checks.CHECKS if each.__name__ == "_keys"]
    assert check(instance).level == "ok"  # it is down: there are none
    bifrost.Network.create(instance.network_file, instance.keys)
    assert check(instance).level == "ok"
    (instance.keys / name).chmod(mode)
    finding = check(instance)
    assert finding.level == "fail"
    assert str(instance.keys / name) in finding.text and f"{mode:04o}" in finding.text
    assert finding.advice is not None and "chmod" in finding.advice
