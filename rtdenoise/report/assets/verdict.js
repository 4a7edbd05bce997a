// The best peer against our network, metric by metric; losses come first.

function drawVerdict() {
  const here = (row) => row.spp === state.spp && row.device === state.device;
  const [lost, won] = [DATA.lost.filter(here), DATA.won.filter(here)];
  const total = lost.length + won.length;
  byId("verdict").hidden = total === 0;
  if (total === 0) return;
  const leaders = {};
  for (const row of lost) (leaders[row.peer] ??= []).push(row.time_ratio);
  const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];
  const names = Object.keys(leaders).sort((a, b) => leaders[b].length - leaders[a].length);
  byId("verdict-text").textContent = lost.length
    ? `At ${state.spp} spp a peer is better than rtdenoise ${DATA.ours} in ${lost.length} of ${total} comparisons: `
      + `${names.map((name) => `${name} in ${leaders[name].length} (${ratio(median(leaders[name]))} our time)`).join(", ")}.`
    : `At ${state.spp} spp no peer is better than rtdenoise ${DATA.ours} in any of ${total} comparisons.`;

  const all = [...lost, ...won];
  const metrics = Object.keys(DATA.metrics).filter((metric) => all.some((row) => row.metric === metric));
  const groups = {};
  for (const row of all) (groups[`${row.sequence}\n${row.region}`] ??= []).push(row);
  const losses = (rows) => rows.filter((row) => lost.includes(row)).length;
  const ordered = Object.entries(groups).sort(([, a], [, b]) => losses(b) - losses(a));
  byId("verdict-table").replaceChildren(element("table", {},
    element("thead", {}, element("tr", {}, element("th", {}, "sequence"), element("th", { class: "text" }, "region"),
      ...metrics.map((metric) => element("th", {}, DATA.metrics[metric].label)))),
    element("tbody", {}, ...ordered.map(([, rows]) => element("tr", {},
      element("td", {}, rows[0].sequence), element("td", { class: "text" }, REGIONS[rows[0].region]),
      ...metrics.map((metric) => verdictCell(rows.find((row) => row.metric === metric), lost)))))));
}

function verdictCell(row, lost) {
  if (!row) return element("td", {}, "–");
  const difference = number(row.metric, Math.abs(row.peer_value - row.our_value));
  const tip = (event) => showTip(event, element("b", {}, `${row.sequence}, ${REGIONS[row.region]}`), element("br"),
    `${row.peer} ${withUnit(row.metric, row.peer_value)} in ${ratio(row.time_ratio)} our time`, element("br"),
    `${DATA.ours} ${withUnit(row.metric, row.our_value)}`);
  const peerWins = lost.includes(row);
  return element("td", { class: peerWins ? "peer" : "win", mousemove: tip, mouseleave: hideTip },
    `by ${difference}`, element("br"), element("small", {}, peerWins ? row.peer : DATA.ours));
}
