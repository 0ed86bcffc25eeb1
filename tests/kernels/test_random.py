import numpy as np

from kempe.kernels.base.random import mix_bits, to_unit_interval


def numbers(state, count):
    with np.errstate(over="ignore"):
        return [mix_bits.py_func(np.uint64(state), np.uint64(i)) for i in range(count)]


def test_published_sequence():
    """The first numbers of SplitMix64 from 1234567, as its authors' C program prints them."""
    assert [int(x) for x in numbers(1234567, 5)] == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]


def test_uniform_and_inside_the_unit_interval():
    x = np.array([to_unit_interval.py_func(b) for b in numbers(0, 4000)])
    assert x.min() >= 0.0 and x.max() < 1.0
    # Kolmogorov and Smirnov, 1 %
    assert np.abs(np.sort(x) - np.linspace(0, 1, 4000)).max() < 1.63 / np.sqrt(4000)
    assert to_unit_interval.py_func(np.uint64(2**64 - 1)) < 1.0


def test_nested_sequences_are_unrelated():
    with np.errstate(over="ignore"):
        x = np.array(
            [
                [to_unit_interval.py_func(mix_bits.py_func(key, np.uint64(i))) for i in range(60)]
                for key in numbers(3, 60)
            ]
        )
    assert (
        np.abs(np.corrcoef(x) - np.eye(60)).max() < 0.6
        and np.abs(np.corrcoef(x.T) - np.eye(60)).max() < 0.6
    )
