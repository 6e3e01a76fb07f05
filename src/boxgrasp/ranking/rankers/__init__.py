"""The rankers that ship: geometry alone, the thesis's four SVM versions, and two to be beaten."""
