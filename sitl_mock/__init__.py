"""A particle simulator of MAVLink vehicles that answers as PX4 and ArduPilot SITL do; imports nothing from fg_gcs.

In process: `sitl_mock.host.server.Simulator` with `SimulatorOptions`. As a process: `python -m sitl_mock`.
Without sockets, for tests: `sitl_mock.host.fleet.Fleet`. Nothing is imported here, so that `--help` stays quick.
"""
