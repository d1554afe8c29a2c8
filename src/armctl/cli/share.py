"""Verbs that share policies: `push` and `pull` through a model hub, `serve` with other processes."""

from pathlib import Path
from typing import Annotated

import typer

from armctl import DEFAULT_ENV
from armctl.cli import completion
from armctl.cli.app import command
from armctl.cli.options import Env, EnvOptions, Robot, checked_agents, checked_policy, environment_options


def checked_agent(agent: str) -> str:
    """Return an agent that may be there: before anything is loaded, an unknown name is told."""
    return checked_agents([agent])[0]


@command()
def push(
    agent: Annotated[
        str,
        typer.Argument(
            help="Agent: a name, the path of its card or graph, or a training's folder.",
            autocompletion=completion.agents,
            callback=checked_agent,
        ),
    ],
    repository: Annotated[str, typer.Argument(metavar="OWNER/NAME", help="Repository; it is made if need be.")],
    private: Annotated[bool, typer.Option("--private", help="Make it a repository that only you see.")] = False,
    message: Annotated[
        str | None, typer.Option(help="Message of the commit.", show_default="the agent's name, and armctl's version")
    ] = None,
    licence: Annotated[
        str | None, typer.Option(help="Licence of the agent, by the hub's names, such as `mit`.", show_default="none")
    ] = None,
) -> None:
    """Upload an agent to Hugging Face's hub, with a model card; needs the extra `hub`.

    The extra: `pip install 'armctl-suite[hub]'`, or `pip install -e '.[hub]'` in a clone. `hf auth login` or the
    variable HF_TOKEN tells the hub who you are, and HF_ENDPOINT can name another hub.

    What is uploaded: `agent.onnx`, `agent.json`, `curve.csv` if there is a learning curve, and a model card made of
    them, `README.md`. The card has all options of the training, paths among them: look at it before you share it.
    """
    from armctl.core.console import PlainConsole
    from armctl.integrations.hub import push as upload

    address = upload(agent, repository, private=private, message=message, licence=licence)
    PlainConsole().print(
        f"{agent} is at {address}. To get it: armctl pull {repository}", soft_wrap=True, highlight=False
    )


@command()
def pull(
    repository: Annotated[
        str,
        typer.Argument(
            metavar="OWNER/NAME[@REVISION]", help="Repository; of a branch, a tag or a commit, if one is named."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder for the agent.", show_default="agents/OWNER/NAME")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace another agent in the folder.")] = False,
) -> None:
    """Download an agent from Hugging Face's hub; needs the extra `hub`.

    An agent cannot run code: `agent.onnx` is a graph of standard operators, `agent.json` is its card, and nothing else
    but a learning curve is downloaded. The graph is checked as each stranger's is, and has to be the one that the card
    describes; otherwise nothing is written.
    """
    from armctl.agents import read_card
    from armctl.core.console import PlainConsole
    from armctl.core.errors import ConfigurationError
    from armctl.integrations.hub import comparison_command
    from armctl.integrations.hub import pull as download

    path = download(repository, out, overwrite=overwrite)
    try:
        how = comparison_command(read_card(path), path)
    except ConfigurationError as error:
        how = str(error)
    PlainConsole().print(f"The agent is {path}: {how}", soft_wrap=True, highlight=False)


@command()
def serve(
    policy: Annotated[
        str, typer.Argument(help="Policy, of any form that `armctl compare` takes.", callback=checked_policy)
    ],
    env: Env = DEFAULT_ENV,
    set_: EnvOptions = None,
    robot: Robot = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 is any that is free.")] = 8000,
    host: Annotated[
        str, typer.Option(help="Address to listen on. Whoever reaches it can use the policy: there is no password.")
    ] = "127.0.0.1",
) -> None:
    """Serve a policy to other processes, until Ctrl-C; needs the extra `remote`.

    armctl compare ws://127.0.0.1:8000 reach_mpc

    The same episodes result as with the policy itself. The protocol is that of openpi's policy servers, so that their
    clients can ask it, too, and `armctl compare ws://HOST:PORT` plays theirs. Policies that see the true state or the
    map stay where the simulator is.
    """
    from armctl.core.console import PlainConsole
    from armctl.runtime.policy_server import serve_policy

    def tell(bound: int) -> None:
        PlainConsole().print(f"{policy} is at ws://{host}:{bound}, until Ctrl-C", soft_wrap=True, highlight=False)

    serve_policy(policy, env, environment_options(env, set_, robot=robot), host, port, tell)
