"""The kinds of faults that the library reports: what each means, and what to do about it.

A program may report kinds of its own with `Actor.report`; these are those of the library itself.
"""

from __future__ import annotations

from typing import Final, NamedTuple

__all__ = ["KINDS", "FaultKind"]


class FaultKind(NamedTuple):
    """What is known of a kind of fault.

    Attributes:
        meaning: What has happened.
        remedy: What to do about it.
    """

    meaning: str
    remedy: str


KINDS: Final[dict[str, FaultKind]] = {
    # -- The program ---------------------------------------------------------------------------------------------
    "exception": FaultKind(
        "A handler or callback of an actor raised an error.",
        "Do what the detail says; where it names a line of code, correct that. `--debug`, or `debug=True`, logs the "
        "traceback.",
    ),
    "task": FaultKind(
        "A task of the TOML file has failed, and the system ends; or it has returned, and the system goes on without "
        "it.",
        "Correct the line that the detail names, or have the task catch what it can go on after; one that is not to "
        "return loops.",
    ),
    "abandoned": FaultKind(
        "A thread or task did not end within its grace after it was cancelled, and goes on without an owner.",
        "Let it look at its cancellation more often, or give it more `grace`.",
    ),
    "stopping": FaultKind(
        "The hook `on_stopping` of an actor did not end in time; the actor ends without it.",
        "Shorten the hook, or give the actor more `patience`.",
    ),
    "overflow": FaultKind(
        "More came from other threads, or over the network, than was taken; some was dropped.",
        "Send less often, let newer messages supersede older ones, or see what holds the event loop.",
    ),
    "endless_turn": FaultKind(
        "A turn went round in a circle: what is published in it causes itself.",
        "Break the circle that the detail names: a callback should not set what it depends on within the same turn.",
    ),
    "starved": FaultKind(
        "A turn goes on without end while other input comes; all ensembles with a safe action are safe until it ends.",
        "Break the circle that the detail names, as for `endless_turn`; `starved_after` says how long one may last.",
    ),
    "stall": FaultKind(
        "The event loop stood still for longer than the watchdog's limit.",
        "Move the call that the detail names to a thread or a process; see docs/safety.md.",
    ),
    "suspended": FaultKind(
        "The machine was suspended; all time limits went on meanwhile, so that what is too old now is unknown.",
        "Nothing, if that was meant; else have the system suspend only while no robot runs.",
    ),
    "emergency": FaultKind(
        "The last resort was called, or has failed.",
        "Find out why a safe action failed twice, or what held the loop; the faults before it say so.",
    ),
    "record": FaultKind(
        "The run goes on, but its record does not, or lacks messages.",
        "The detail says why. Free the disk where it is full; find what has ended the process that writes, as the "
        "system does for want of memory; record less, or with a larger `bound`, where too much waited.",
    ),
    "observer": FaultKind(
        "The record, the page or the log has failed and lacks something; the run goes on as if it had not been there.",
        "The detail says which and why, and how much it lacks is counted. A message that cannot be written as JSON is "
        "for the one who publishes it to correct; an error in the library is worth a report.",
    ),
    # -- Sensors and places --------------------------------------------------------------------------------------
    "sensor": FaultKind(
        "A sensor told a value that its predicate cannot have, or has told none; the predicate is unknown.",
        "Correct what the sensor hands over: True, False or None.",
    ),
    "stale": FaultKind(
        "Nothing was told for longer than values hold (`max_age`), so that what depends on it is unknown; or a "
        "message of a team was of an earlier life of its sender, and was dropped.",
        "See whether the sensor, the localisation or the other agent still runs, or allow a longer `max_age`. "
        "Messages: nothing after a restart; else look for two processes of one name.",
    ),
    "violation": FaultKind(
        "Of predicates or events of which exactly one should hold, none or several did; `on_violation` was done.",
        "Make their formulas exclude each other, or say what shall count with `on_violation`.",
    ),
    "pose": FaultKind(
        "A pose is not finite, on a floor that the map has not, or less certain than is allowed.",
        "Correct what tells poses; names of floors are those of `building.toml`.",
    ),
    "late": FaultKind(
        "Poses come with stamps that are older than `max_age`, so that none counts.",
        "Stamp them by the runtime's clock, or allow a longer `max_age`.",
    ),
    "particles": FaultKind(
        "Particles tell no belief: none that weighs anything lies in a place, or a weight is no number of 0 or more.",
        "See whether they are in the frame of the map, and whether the filter has diverged.",
    ),
    # -- Decisions -----------------------------------------------------------------------------------------------
    "waiting": FaultKind(
        "An ensemble should decide and cannot: its state is not known, or its team is not there.",
        "The detail names the predicates or agents; `statistics().waiting` lists them, `mdm info` says who tells them. "
        "A number between the two bounds of a threshold leaves it unknown at the start: give it `initial`.",
    ),
    "idle": FaultKind(
        "An ensemble decides and has nothing to do: its action has ended, and nothing decides again.",
        'Say `then = "decide"` or `"wait"` at the action, or have an input change; see docs/safety.md.',
    ),
    "livelock": FaultKind(
        "An ensemble decides again and again, and nothing comes of it: an action succeeds at once each time, or a "
        "predicate flaps.",
        "Have an action succeed by what it is decided on. Let a predicate of a number change by two thresholds "
        "(`until`), or hold before it counts (`held_for`); or decide at a fixed rate.",
    ),
    "state": FaultKind(
        "The policy or the controller refused a state.",
        "The detail names the state; see whether the policy belongs to the model (`mdm check`).",
    ),
    "policy": FaultKind(
        "The policy failed to choose an action for a belief, or its code raised an error.",
        "Correct the policy that the detail names.",
    ),
    "observation": FaultKind(
        "An observation could not be taken into the belief.",
        "The detail says why; names of symbols are those of the model.",
    ),
    "impossible_observation": FaultKind(
        "What was observed has probability 0 by the model.",
        "Correct the model, which says that it never happens, or say what to do with `on_impossible`.",
    ),
    "no_observation": FaultKind(
        "A simulated world saw no observation for so long that it ended the episode.",
        "Give every state of the model a chance of being observed.",
    ),
    "belief": FaultKind(
        "A belief from outside was refused.",
        "It has to be a probability for each state of the model, in its order, that sum to 1.",
    ),
    "deadline": FaultKind(
        "No decision was ready at the deadline; the fallback decided, or the ensemble is safe.",
        "Give the search less time than the deadline, the machine more, or the policy a fallback.",
    ),
    "search": FaultKind(
        "The process that searches is not there, does not answer, or has ended.",
        "The detail says which; it is started again, and a `deadline` with a fallback bridges the time.",
    ),
    "shield": FaultKind(
        "The fallback of a shielded search has no shield.",
        "Shield the search with its fallback, and leave `fallback` as `mdm.shield` has made it.",
    ),
    "control": FaultKind(
        "An ensemble was not started, since one above it is safe or ends.",
        "Start it when that is over; it starts by itself with the action that it is bound to.",
    ),
    "drift": FaultKind(
        "What follows an action differs from the model, at the odds that were chosen.",
        "Re-estimate the model from a record (docs/statistics.md) and solve it; where something impossible happened, "
        "see to the sensors first.",
    ),
    "unwatched": FaultKind(
        "A drift monitor watches nothing: where beliefs come from outside, what was observed is not known here.",
        "Take the drift monitor away, or hand in observations; mdm statistics cannot count such decisions, either.",
    ),
    # -- Actions and safety --------------------------------------------------------------------------------------
    "action": FaultKind(
        "An action failed, timed out, was abandoned or gave up, or begins beside one that was abandoned.",
        "Correct the callback that the detail names; `on_failed_action`, `then` and `attempts` say what follows.",
    ),
    "quality": FaultKind(
        "The other side of a topic of ROS has another quality of service, or type: no message passes.",
        "Give both the same: `qos` in the entry of the topic, or the quality or type of the other node.",
    ),
    "unmatched": FaultKind(
        "Nobody is at the other end of a topic, a service or an action of ROS.",
        "Start the node that should be there, or correct the name and type of what the detail names.",
    ),
    "safe_action": FaultKind(
        "The safe action failed or did not come to its end; after the second time the emergency is called.",
        "Make the safe action short and simple; look at the robot, then `release()` the ensemble.",
    ),
    "stale_input": FaultKind(
        "What an ensemble decides on is too old, so that it is safe or says so.",
        "See to the sensors that the detail names; it decides again when they are heard.",
    ),
    "unknown_input": FaultKind(
        "The state of an ensemble turned unknown, so that it is safe or says so.",
        "See to the predicates that the detail names; it decides again when they are known.",
    ),
    # -- Teams: members ------------------------------------------------------------------------------------------
    "missing_teammate": FaultKind(
        "An agent of the team was never met. Without more than half of the team (of two, without the other one) a "
        "replicated or centralised one decides nothing.",
        "Start it; or compare endpoints, the team's name and the order of agents; `mdm team status` asks them. Where "
        "it is not to come, `mdm team start` lets this agent decide without it.",
    ),
    "lost_teammate": FaultKind(
        "An agent of the team is not heard any more.",
        "See to its process and the network; it takes part again by itself.",
    ),
    "lost_majority": FaultKind(
        "An agent sees no majority of its team, and decides nothing.",
        "See to the network between the agents that the detail names.",
    ),
    "lost_controller": FaultKind(
        "The agent that decides for a centralised team is not heard.",
        "See to its process and the network; decisions go on by themselves.",
    ),
    "refused": FaultKind(
        "An agent has another configuration than the team, and takes no part.",
        "The detail names the first difference: give all agents the same file, model, policy and version.",
    ),
    "stranger": FaultKind(
        "Another agent says that it is of this team, which does not have it.",
        "Its file or the team's name differs: `mdm team check` on both machines.",
    ),
    "clock": FaultKind(
        "The clock of an agent, or that of a topic's stamps, differs from this one's by more than is allowed.",
        "Synchronise the machines' clocks, by chrony or PTP; start an agent again whose clock was put right meanwhile.",
    ),
    "held": FaultKind(
        "This agent was stopped, or waits for a release, and stays so: beside a team that decides, or since before its "
        "process began.",
        "Start the team again when that is safe: `mdm team start`, and `mdm team release` where it waits for that.",
    ),
    "storage": FaultKind(
        "The file in which an agent keeps that it was stopped cannot be read, and the agent starts stopped; "
        "or it cannot be written, and a stop does not outlive the process.",
        "The detail names the file and the reason. Unread, it is replaced by the next command, and removed by "
        "`mdm team start` or `mdm team up --fresh`; unwritten, free the disk and give the command again.",
    ),
    "void_command": FaultKind(
        "A command was not done: a stop came before it, or the term in which it was asked for has ended.",
        "Ask again, if it is still meant.",
    ),
    # -- Teams: the agreement ------------------------------------------------------------------------------------
    "digest": FaultKind(
        "The copies of two agents differ after the same step; the one that differs takes the other's.",
        "Policies and models have to be the same and deterministic; report it with both records of decisions.",
    ),
    "history": FaultKind(
        "An agent reports steps that cannot be; all say again what they have.",
        "Once is an agent that came back; again and again, look for two processes of one name.",
    ),
    "snapshot": FaultKind(
        "An agent took the team's state from another one, in place of steps that it missed.",
        "Nothing, once; again and again, see why it misses steps.",
    ),
    "decisions": FaultKind(
        "Lines of decisions cannot be written to their file; what is decided goes on.",
        "See whether the disk is full, or the folder may be written.",
    ),
    "word": FaultKind(
        "An agent of a communicating team said what cannot be.",
        "See whether its model is the same, and whether somebody else sends in its name.",
    ),
    # -- Teams: messages -----------------------------------------------------------------------------------------
    "unprotected": FaultKind(
        "The team's messages are not protected: whoever reaches the port can command the robot.",
        "Use certificates, or a network of the robots alone: docs/team-security.md says how.",
    ),
    "certificate": FaultKind(
        "An agent's certificate, or its authority's, ends within two days: nobody connects to it then.",
        "Renew its files, and start the agents again one after the other: the team goes on meanwhile.",
    ),
    "oversize": FaultKind(
        "A message is larger than is taken, and was not sent, or was dropped.",
        "Send less in it, or raise the limit in `[team]`, at all agents.",
    ),
    "malformed": FaultKind(
        "A message could not be read, and was dropped.",
        "Another program, or a forger, sends it: the detail names the key, which begins with team and sender.",
    ),
    "version": FaultKind(
        "A message is of another version of the library's format, and was dropped.",
        "Install the same version of the library at all agents.",
    ),
    "foreign": FaultKind(
        "A message came under a key of another agent than its sender, or of this one, and was dropped.",
        "Look for two processes of one name, or of two teams of one name; else somebody sends in another's name: use "
        "certificates.",
    ),
    "repeated": FaultKind(
        "A message came again, or after a newer one of its key, and was dropped.",
        "Nothing, for a few; many mean two processes of one name, of two ways between the agents, or of a "
        "recording that is played.",
    ),
    "untimely": FaultKind(
        "A message has a stamp of a day or more from this agent's clock, and was dropped.",
        "Set the clock of its sender, or of this machine.",
    ),
    "incredible": FaultKind(
        "What a message says cannot be, such as an action that the model has not or a term that nobody leads; it was "
        "dropped.",
        "Nothing, once, while an agent with another configuration comes or goes; again and again, look at its sender, "
        "which the detail names.",
    ),
    "ignored": FaultKind(
        "A sender of many messages that no agent sends is ignored for a while.",
        "Find out what it is: the detail names it.",
    ),
    "renumbered": FaultKind(
        "Messages of a sender begin to be counted again without a new life.",
        "Look for two processes of one name.",
    ),
    "missing": FaultKind(
        "Messages of a sender were lost on the way.",
        "See to the network; decisions do without them, as docs/teams.md says.",
    ),
    "duplicate": FaultKind(
        "Another process of this agent's name is live, or asks, in the team.",
        "End one of the two: `ps` shows them as `mdm run FILE --agent NAME`; on two machines, compare their files. The "
        "detail says where each listens, if the two are not connected.",
    ),
    "held_back": FaultKind(
        "A message was not sent, for the connection takes no more at the moment.",
        "Send less often, or widen the link.",
    ),
    "closed": FaultKind(
        "A message was not sent, for its session has ended.",
        "Nothing at the end of a program; else see why the session ended.",
    ),
    "follow": FaultKind(
        "A predicate or event of another agent is used, which that agent does not have.",
        "Correct the name; the detail names the nearest.",
    ),
    "export": FaultKind(
        "A message of a channel that goes to other agents could not be sent.",
        "The detail says why: its type, or its size.",
    ),
    "import": FaultKind(
        "A message of another agent's channel could not be taken.",
        "Give both agents the same type of message.",
    ),
}
"""The kinds, with the name under which a `Fault` has them."""
