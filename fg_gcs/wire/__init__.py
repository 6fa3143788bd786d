"""MAVLink without input and output: bytes, messages and times in, bytes and state out; the only user of pymavlink."""
