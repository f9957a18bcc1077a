from echoavatar_lab.tables.hardware import hardware


def test_hardware_is_named() -> None:
    assert "cores" in hardware("cpu")
