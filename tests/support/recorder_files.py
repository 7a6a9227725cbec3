"""Files of recorders, written with their libraries; a test that needs one that is not installed is skipped."""

import json

import h5py
import numpy as np
import pytest

from tests.support.written_log import COLUMNS, TIME, N

SIGNALS = {name: values for name, values in COLUMNS.items() if name != "time"}


def write_mdf(path, groups, **options):
    """Groups of (stamps, {name: values or keywords of a Signal})."""
    library = pytest.importorskip("asammdf", reason="asammdf is an extra")
    with library.MDF(version="3.30" if path.suffix == ".mdf" else "4.10") as file:
        for name, (stamps, channels) in groups.items():
            signals = [
                library.Signal(**(one if isinstance(one, dict) else {"samples": one}), timestamps=stamps, name=key)
                for key, one in channels.items()
            ]
            file.append(signals, acq_source=None, comment=name, **options)
            if path.suffix == ".mf4":
                file.groups[-1].channel_group.acq_name = name
        file.save(path, overwrite=True)


def write_tdms(path, channels):
    """Channels of (group, name, values, properties)."""
    library = pytest.importorskip("nptdms", reason="npTDMS is an extra")
    with library.TdmsWriter(str(path)) as file:
        file.write_segment([library.ChannelObject(*channel) for channel in channels])


def write_hdf5(path, arrays, units=None):
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values
            if units and name in units:
                file[name].attrs["units"] = units[name]


def write_mcap(path, topics, *, encoding="json", **options):
    """Topics of (stamps in ns, fields by name)."""
    library = pytest.importorskip("mcap.writer", reason="mcap is an extra")
    with path.open("wb") as stream:
        file = library.Writer(stream, **options)
        file.start()
        schema = file.register_schema("signals", "jsonschema", b"{}")
        for topic, (stamps, fields) in topics.items():
            channel = file.register_channel(topic, encoding, schema)
            for k, stamp in enumerate(stamps):
                data = {name: values[k] for name, values in fields.items()}
                file.add_message(channel, int(stamp), json.dumps(data).encode(), int(stamp))
        file.finish()


STAMPS = 1_700_000_000_000_000_000 + np.rint(1e9 * TIME).astype(np.int64)
LISTS = {name: values.tolist() for name, values in SIGNALS.items()}
WAVEFORM = {"wf_start_offset": 0.0, "wf_increment": 1e-3, "wf_samples": N}


def write_plain(path):
    """The log as each format holds it plainly."""
    if path.suffix in (".mf4", ".mdf"):
        write_mdf(path, {"axis": (TIME, SIGNALS)})
    elif path.suffix == ".tdms":
        write_tdms(path, [("axis", name, values, WAVEFORM) for name, values in SIGNALS.items()])
    elif path.suffix == ".mcap":
        write_mcap(path, {"/axis": (np.rint(1e9 * TIME), LISTS)})
    else:
        write_hdf5(path, COLUMNS)
