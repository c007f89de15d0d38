"""One module a log format; each yields sequences of detections and poses."""
