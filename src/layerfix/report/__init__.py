"""The report: one page, in one file, that shows what correction did to every layer (`layerfix.report.page`)."""
