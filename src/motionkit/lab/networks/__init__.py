"""Networks of other papers to compare with: windows of features and controls in, the next frame out."""
