"""A particle simulator of MAVLink vehicles; imports nothing from fg_gcs."""
