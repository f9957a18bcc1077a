from echoavatar_research.hardware import hardware


def test_hardware_is_named() -> None:
    assert "cores" in hardware("cpu")
