"""Lenses as tables of surfaces, from which tests of the import build systems."""

from mistray.prescription import Decentre, Prescription, Row, Sequential


def lens(*rows: Row, **system) -> Sequential:
    return Sequential("test", rows, **({"aperture": 10.0} | system))


def triplet(**system) -> Sequential:
    return lens(
        Row(1, radius=22.01359, thickness=3.25896, material="1.62041"),
        Row(2, radius=-435.76044, thickness=6.00755),
        Row(3, radius=-22.21328, thickness=0.99998, material="1.62005"),
        Row(4, radius=20.29192, thickness=2.0),
        Row(5, stop=True, thickness=2.75041),
        Row(6, radius=79.6836, thickness=2.95208, material="1.62041"),
        Row(7, radius=-18.39533, thickness=42.20778),
        Row(8, kind="image"),
        **({"fields": ((0.0, 0.0), (0.0, 14.0), (0.0, 20.0))} | system),
    )


TURN = Decentre(tilt_deg=(45.0, 0.0, 0.0))


def newtonian(**system) -> Sequential:
    return lens(
        Row(1, thickness=1000.0, label="sky"),
        Row(2, radius=-2000.0, conic=-1.0, mirror=True, stop=True, thickness=-800.0, label="primary"),
        Row(3, kind="coordinate_break", decentre=TURN),
        Row(4, mirror=True, label="flat"),
        Row(5, kind="coordinate_break", decentre=TURN, thickness=200.0),
        Row(6, kind="image"),
        **({"aperture": 200.0, "fields": ((0.0, 0.0), (0.0, 0.5))} | system),
    )


BORED = lens(
    Row(1, thickness=60.0),
    Row(2, radius=-150.0, thickness=8.0, material="1.5168", stop=True),
    Row(3, radius=-220.0, thickness=-8.0, mirror=True, material="1.5168"),
    Row(4, radius=-150.0, thickness=-55.0),
    Row(5, radius=-250.0, mirror=True, thickness=54.0),
    Row(6, radius=40.0, thickness=4.0, material="1.6"),
    Row(7, radius=-300.0, thickness=20.0),
    Row(8, kind="image"),
    aperture=50.0,
    fields=((0.0, 0.0), (0.0, 0.5)),
)


def by_name(prescription: Prescription) -> dict:
    return {shape.name: shape for shape in prescription.shapes()}
