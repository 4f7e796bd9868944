# Copyright 2026 hysteresis_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software distributed under the License is distributed on
# an "AS IS" BASIS, WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the
# specific language governing permissions and limitations under the License.

"""``hysteresis models``: which models can be identified, their parameters, units, options and inverses."""

from __future__ import annotations

import click

from hysteresis_ros.errors import ConfigurationError


@click.command(short_help="List the models with parameters, units and inverses.")
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--yaml", "as_yaml", is_flag=True, help="Print the parameter file of an axis with an example of NAME.")
def models(name, as_json, as_yaml):
    """Print all models, or all about the model NAME."""
    from hysteresis_ros.identification.registry import find_model
    from hysteresis_ros.models.hysteresis import MODELS

    chosen = {name: find_model(name)} if name else MODELS
    if as_yaml:
        from hysteresis_ros.identification.parameter_file import example_text

        if not name:
            raise ConfigurationError(f"--yaml: of which model? There are: {', '.join(MODELS)}")
        click.echo(example_text(chosen[name]), nl=False)
        return
    if as_json:
        import json

        click.echo(json.dumps({key: _entry(model) for key, model in chosen.items()}, indent=2, ensure_ascii=False))
        return
    click.echo("\n".join(line for key, model in chosen.items() for line in _lines(key, model, bool(name))))


def _entry(model) -> dict:
    from hysteresis_ros.identification.registry import linear_words

    return {
        "title": model.title,
        "data": model.data,
        "inverses": list(model.inverses),
        "linear": ["auto", "none", *linear_words(model)],
        "parameters": [
            {"name": row.name, "unit": row.unit, "type": row.type_name, "description": row.description}
            for row in model.rows()
        ],
        "options": {key: option.description for key, option in model.options.items()},
    }


def _lines(name, model, whole):
    from hysteresis_ros.identification.linear_stage import STAGES
    from hysteresis_ros.identification.registry import linear_words

    linear = linear_words(model)
    yield f"{name}: {model.title}"
    yield f"  data      {model.data}"
    yield f"  inverse   {', '.join(model.inverses)}"
    if linear:
        yield f"  linear    {', '.join(('auto', 'none', *linear))}"
    yield "  parameters"
    for row in model.rows():
        unit = f" [{row.unit}]" if row.unit else ""
        yield f"    {row.name}{unit}: {row.description}"
    if model.options:
        yield "  options (-p NAME=VALUE)"
        for key, option in model.options.items():
            choices = f" ({', '.join(option.choices)})" if option.choices else ""
            yield f"    {key}: {option.description}{choices}"
    if whole and model.stages:
        yield "  linear stages"
        for key, text in STAGES.items():
            yield f"    {key}: {text}"
    yield ""
