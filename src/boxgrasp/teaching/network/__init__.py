"""The segmentation network's own training: examples cast as it goes, the network, the loop."""
