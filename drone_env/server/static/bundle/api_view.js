
import{B as e,P as t,g as n,m as r,y as i}from"./main.js";const a=[`requests`,`training`],o=e=>[[`HTTP, by curl`,`curl --silent --cookie-jar jar --json '{"task_name": "easy", "seed": 7}' ${e}/reset
curl --silent --cookie jar --json '{"direction": "RIGHT"}' ${e}/step
curl --silent --cookie jar ${e}/grade/easy
curl --silent --cookie jar --request DELETE ${e}/session`],[`OpenEnv, in Python`,`from drone_env.client import DroneDeliveryClient
from drone_env.models import DroneAction

with DroneDeliveryClient("${e}").sync() as env:
    result = env.reset(task_name="hard", seed=7)
    while not result.done:
        result = env.step(DroneAction(direction="RIGHT"))
    print(result.observation.score, env.state().seed)`]];function s(n,i){let{api:s,server:u}=i,d=r(`.`).href.replace(/\/$/,``),f=s.guarded()?t(`span`,` Send `,t(`code`,{text:`Authorization: Bearer TOKEN`}),` with each request.`):null,p=l(`Requests`,`log-requests`,`No request yet.`),m=l(`Training`,`log-training`,`No training log yet. To start a training, run: drone-env train`);n.append(t(`div.view-head`,t(`h2`,{text:`API`}),t(`a.button.primary`,{href:`docs`,text:`All endpoints`})),t(`p.about`,`This server is `,t(`code`,{text:d}),`. Any HTTP client can fly here.`,f),t(`div.snippets`,...o(d).map(([t,n])=>e(t,n))),t(`div.logs`,p.root,m.root)),u.on(`requests`,e=>{e.fresh&&p.clear(),p.add(e.requests.map(c))}),u.on(`training`,({lines:e})=>{m.clear(),m.add(e.map(e=>t(`li`,{text:e})))}),i.on(`view`,e=>e===`api`&&u.watch(a))}function c({time:e,method:r,path:a,status:o,milliseconds:s}){return t(`li`,{data:{bad:o>=400?`yes`:`no`}},t(`time.dim`,{datetime:e,text:new Date(e).toLocaleTimeString(n)}),` ${r} ${a} ${o} `,t(`span.dim`,{text:`${i(s,1)} ms`}))}function l(e,n,r){let i=`${n}-title`,a=t(`ol`,{id:n}),o=t(`div.log-frame`,{tabindex:`0`,role:`log`,"aria-live":`off`,"aria-labelledby":i},a),s=t(`h3`,{id:i,text:e}),c=t(`section.log`,{"aria-labelledby":i},s,t(`p.note`,{text:r}),o);function l(e){let t=o.scrollTop+o.clientHeight>=o.scrollHeight-8;for(a.append(...e);a.childElementCount>200;)a.firstElementChild.remove();t&&(o.scrollTop=o.scrollHeight)}return{root:c,add:l,clear:()=>a.replaceChildren()}}export{s as mount};