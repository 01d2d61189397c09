"""Reports of campaigns: summary, heat maps, sensitivity, report sections, the HTML page."""
