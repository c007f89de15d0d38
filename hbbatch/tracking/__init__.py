"""Many sequences in lock step: detections in, tracks out."""
