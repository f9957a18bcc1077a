from echoavatar_lab.corpora.dance.steps import LEFT, RIGHT, Figure, Step, first_foot, mirrored, parse_pairs, parse_steps


def test_the_notation_is_parsed() -> None:
    plain, rich = parse_steps("0 L; 2.5 R x-.1 z.2 y.3 w0 l.05 p-.4 t.9 air:1.5/.02/.2/.38")
    assert plain == Step(0.0, LEFT)
    assert rich == Step(2.5, RIGHT, -0.1, 0.2, 0.3, 0.0, 0.05, -0.4, 0.9, (1.5, 0.02, 0.2, 0.38))


def test_pairs() -> None:
    assert parse_pairs("0 .5, 2 -.25") == ((0.0, 0.5), (2.0, -0.25))


def test_a_mirror_image_starts_on_the_other_foot_and_twice_is_the_same() -> None:
    figure = Figure("f", 4, parse_steps("1 R x.1; 0 L x.2 y.1 air:-.5/.1/.2/.3"), twist=((0, 0.1),), shift=((1, 0.7),))
    other = mirrored(figure)
    assert (first_foot(figure), first_foot(other)) == (LEFT, RIGHT)
    assert other.steps[1].x == -0.2
    assert other.steps[1].air == (-0.5, -0.1, 0.2, 0.3)
    assert other.twist == ((0, -0.1),)
    assert mirrored(other).steps == figure.steps


def test_a_figure_on_planted_feet_has_no_first_foot() -> None:
    assert first_foot(Figure("still", 8, ())) is None
