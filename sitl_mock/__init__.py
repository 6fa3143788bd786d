"""A particle simulator of MAVLink vehicles that answers as PX4 and ArduPilot SITL do; imports nothing from fg_gcs.

In process: `sitl_mock.server.Simulator` with `sitl_mock.server.SimulatorOptions`. As a process: `python -m sitl_mock`.
Without sockets, for tests: `sitl_mock.fleet.Fleet`. Nothing is imported here, so that `--help` stays quick.
"""
