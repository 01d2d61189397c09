"""Reports of campaigns: summary, heat maps, sensitivity, sections, the page."""
