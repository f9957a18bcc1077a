from echoavatar_character.face_sheet import face_sheet


def test_every_shape_has_its_own_picture() -> None:
    """Rest and four shapes, no two alike; the jaw's cell has more dark (an open mouth) than the face at rest."""
    sheet = face_sheet(("jawOpen", "eyeBlinkLeft", "mouthSmileRight", "tongueOut"), columns=3, size=(40, 44))
    assert sheet.shape == (2 * 44, 3 * 40, 3)
    cells = sheet.reshape(2, 44, 3, 40, 3).transpose(0, 2, 1, 3, 4).reshape(6, 44, 40, 3).astype(int)
    assert len({cell.tobytes() for cell in cells[:5]}) == 5
    assert not cells[5].any()
    dark = (cells[:, 22:].sum(3) < 120).sum((1, 2))
    assert dark[1] > dark[0] + 5
