"""Words that every floor uses: names, units, arguments, linear algebra, what other packages bring."""
