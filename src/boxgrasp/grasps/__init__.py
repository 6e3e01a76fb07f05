"""The grasp candidates of a box, the hand, the checks and the score of a clearance."""
