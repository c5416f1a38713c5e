"""Using the leaderboard's page in a browser as a visitor does."""


def watch(page, scenario, agent, episode=None):
    """Choose a scenario, and open a flight of an agent."""
    page.select_option("#scenario", scenario)
    page.click(f"tr[data-name={agent}] .open")
    page.wait_for_selector(f".pane h3:has-text('{agent} · {scenario}')")
    if episode is not None:
        page.fill("#episode", str(episode))
        page.locator("#episode").dispatch_event("change")
        page.wait_for_selector(f".pane h3:text-matches('episode {episode}$')")
