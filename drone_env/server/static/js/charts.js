// Charts, drawn by uPlot.
